"""How each run was made, on which machine, and where its time went."""

from __future__ import annotations

from collections.abc import Sequence

from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.result import Result
from dofbench.reporting import standing
from dofbench.reporting.boards import Board
from dofbench.reporting.tables import Cell, Heading, Table, cells, word_headings, words

_UNKNOWN = "unknown"


def run_table(entries: Sequence[Entry], boards: Sequence[Board]) -> tuple[Table, tuple[str, ...]]:
    """(table of command, code and machine of every run; the machines by their number in the table)."""
    machines: dict[str, int] = {}
    rows = []
    for entry in entries:
        started, command, commit, machine, disabled, enabled = _how(entry.result, machines)
        code = entry.spec.key[:8], entry.spec.code.rpartition("+")[2][:8]
        status = str(entry.status), entry.spec.budget, started, command
        rows.append(cells(*_names(entry, boards), *status, *code, commit, machine, disabled, enabled))
    headings = (
        *word_headings("dataset", "method", "preset", "seed", "status", "budget"),
        *word_headings("started (UTC)", wide=True),
        *word_headings("command", "key", "code", "commit", "machine"),
        *word_headings("disabled stages", "enabled stages, and why", wide=True),
    )
    listed = tuple(f"Machine {count}: {described}" for described, count in machines.items())
    return Table("How each run was made", headings, tuple(rows), below=_notes(boards)), listed


def _how(result: Result | None, machines: dict[str, int]) -> tuple[str, Cell, str, str, str, str]:
    """(start, command, commit, number of the machine, disabled stages, enabled stages). machines: their numbers so
    far."""
    if result is None:
        return _UNKNOWN, words(_UNKNOWN), _UNKNOWN, _UNKNOWN, "", ""
    machine = machines.setdefault(machine_text(result), len(machines) + 1)
    enabled = [f"{stage['name']}: {stage['reason']}" for stage in result.plan.get("stages", ()) if stage["runs"]]
    disabled = [f"{stage}: {why}" for stage, why in result.left_out_stages.items()]
    command = Cell("", sort=result.command, code=(result.command,))
    started = result.started[:16].replace("T", " ")
    return started, command, commit_text(result), str(machine), "; ".join(disabled), "; ".join(enabled)


def stage_table(entries: Sequence[Entry], boards: Sequence[Board]) -> Table:
    """The time of each run by stage."""
    timed = [(entry, entry.result) for entry in entries if entry.result is not None]
    stages = list(dict.fromkeys(stage for _, result in timed for stage in result.stages))
    own = list(dict.fromkeys(stage for _, result in timed for stage in result.method_stages))
    headings = (
        *word_headings("dataset", "method", "preset", "seed"),
        *(Heading(f"{stage} [s]", "harness") for stage in stages),
        *(Heading(f"{stage} [s]", "within training") for stage in own),
    )
    rows = []
    for entry, result in timed:
        times = [result.stages[stage].wall if stage in result.stages else None for stage in stages]
        times += [result.method_stages.get(stage) for stage in own]
        shown = (Cell("not run", "number") if time is None else Cell(f"{time:.2f}", "number", time) for time in times)
        rows.append((*_names(entry, boards), *shown))
    caption = "Wall seconds of the harness's stages, and of the method's own within training"
    return Table(caption, headings, tuple(rows), below=_notes(boards))


def _names(entry: Entry, boards: Sequence[Board]) -> tuple[Cell, ...]:
    board = next(board for board in boards if board.key == entry.board)
    line, seed = board.lines[entry.variant], Cell(str(entry.spec.seed), sort=float(entry.spec.seed))
    return cells(board.name, words(line.method, line.signs), line.preset, seed)


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
    accelerator = [str(facts["accelerator"])] if "accelerator" in facts else []
    cpu = f"{facts['cpu']}, {facts['cores']} cores{threads}, {facts['memory_gib']} GiB"
    return ", ".join([cpu, str(facts["os"]), f"Python {facts['python']}", *accelerator])
