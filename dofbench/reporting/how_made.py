"""How each run was made, on which machine, and where its time went."""

from __future__ import annotations

from collections.abc import Sequence

from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.result import Result
from dofbench.reporting import standing, table_cells
from dofbench.reporting.boards import Board
from dofbench.reporting.summary import Line
from dofbench.reporting.view import Cell, Heading, Items, Table

_CAPTION = "How each run was made"
_ABOUT_STAGES = "Wall seconds of the harness's stages, and of the method's own within training"
_UNKNOWN = "unknown"


def run_table(entries: Sequence[Entry], boards: Sequence[Board]) -> tuple[Table, Items]:
    """(table of command, code and machine of every run; list of the machines by their number in the table). Further
    details are in each run's result.json."""
    by_key = {board.key: board for board in boards}
    machines: dict[str, int] = {}
    rows = []
    for entry in entries:
        result, board = entry.result, by_key[entry.board]
        line = board.lines[entry.variant]
        machine = str(machines.setdefault(machine_text(result), len(machines) + 1)) if result else _UNKNOWN
        left = "; ".join(f"{stage}: {why}" for stage, why in result.left_out_stages.items()) if result else ""
        rows.append(
            (
                *_names(board, line),
                _seed(entry),
                *(table_cells.words(text) for text in (str(entry.status), entry.spec.budget)),
                table_cells.words(_minute(result.started) if result else _UNKNOWN),
                Cell("", sort=result.command, code=(result.command,)) if result else table_cells.words(_UNKNOWN),
                table_cells.words(entry.spec.key[:8]),
                table_cells.words(entry.spec.code.rpartition("+")[2][:8]),
                table_cells.words(commit_text(result) if result else _UNKNOWN),
                table_cells.words(machine),
                table_cells.words(left),
                table_cells.words(_runs(result)),
            )
        )
    plain = table_cells.word_headings
    headings = (
        *plain("dataset", "method", "preset", "seed", "status", "budget"),
        Heading("started (UTC)", words=True, wide=True),
        *plain("command", "key", "code", "commit", "machine"),
        Heading("left out of the method", words=True, wide=True),
        Heading("what runs, and why", words=True, wide=True),
    )
    listed = Items(tuple(f"Machine {count}: {described}" for described, count in machines.items()))
    return Table(_CAPTION, headings, tuple(rows), below=_notes(boards)), listed


def stage_table(entries: Sequence[Entry], boards: Sequence[Board]) -> Table:
    """The time of each run by stage."""
    by_key = {board.key: board for board in boards}
    timed = [(entry, entry.result) for entry in entries if entry.result is not None]
    stages = list(dict.fromkeys(stage for _, result in timed for stage in result.stages))
    own = list(dict.fromkeys(stage for _, result in timed for stage in result.method_stages))
    headings = (
        *table_cells.word_headings("dataset", "method", "preset", "seed"),
        *(Heading(f"{stage} [s]", "harness") for stage in stages),
        *(Heading(f"{stage} [s]", "within training") for stage in own),
    )
    rows = []
    for entry, result in timed:
        board = by_key[entry.board]
        line = board.lines[entry.variant]
        times = [result.stages[stage].wall if stage in result.stages else None for stage in stages]
        times += [result.method_stages.get(stage) for stage in own]
        rows.append(
            (
                *_names(board, line),
                _seed(entry),
                *(Cell("not run", "number") if time is None else Cell(f"{time:.2f}", "number", time) for time in times),
            )
        )
    return Table(_ABOUT_STAGES, headings, tuple(rows), below=_notes(boards))


def _names(board: Board, line: Line) -> tuple[Cell, Cell, Cell]:
    return table_cells.words(board.name), table_cells.words(line.method, line.signs), table_cells.words(line.preset)


def _notes(boards: Sequence[Board]) -> tuple[str, ...]:
    return standing.notes(line.signs for board in boards for line in board.lines.values())


def commit_text(result: Result) -> str:
    """The commit that a run was made with."""
    git = result.git
    return "no checkout" if git is None else git.commit[:12] + (" + changes" if git.dirty else "")


def machine_text(result: Result) -> str:
    """The machine that a run was made on."""
    facts = result.machine
    threads = f" ({facts['threads']} used)" if "threads" in facts else ""
    parts = [
        f"{facts['cpu']}, {facts['cores']} cores{threads}, {facts['memory_gib']} GiB",
        str(facts["os"]),
        f"Python {facts['python']}",
    ]
    if "accelerator" in facts:
        parts.append(str(facts["accelerator"]))
    return ", ".join(parts)


def _seed(entry: Entry) -> Cell:
    return Cell(str(entry.spec.seed), sort=float(entry.spec.seed))


def _runs(result: Result | None) -> str:
    """Which stages the plan or the training decided to run or leave out, with the reasons."""
    stages = result.plan.get("stages", ()) if result else ()
    return "; ".join(f"{stage['name']}: {stage['reason']}" for stage in stages if stage["runs"])


def _minute(moment: str) -> str:
    """A time such as 2026-11-21T19:37:27+00:00 in the form 2026-11-21 19:37; results have UTC."""
    return moment[:16].replace("T", " ")
