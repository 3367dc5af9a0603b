"""Every score of every board, and how each run was made."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from dofbench.reporting.held_out import ASKED_HEADING, COLUMNS_SHOWN, asked_lines
from dofbench.reporting.html.boards import Board
from dofbench.reporting.html.layouts import not_shown
from dofbench.reporting.html.markup import Notes, Td, Th, score_cell, score_heading, table, text_cell
from dofbench.reporting.markdown import commit_text, machine_text
from dofbench.reporting.summary import Line, best_texts, empty_columns, sorted_lines
from dofbench.results.collecting import Collection, grouped
from dofbench.results.columns import COLUMNS, SCORES
from dofbench.results.result import Result

_ABOUT_STAGES = "Wall seconds of the harness's stages, and of the method's own within training"


def board_sections(boards: Sequence[Board], notes: Notes) -> str:
    """One section for each board: all of its scores, and for a held-out focus what the test views ask for."""
    sections = []
    for board in boards:
        lines = sorted_lines([*board.lines.values(), *([board.nothing] if board.nothing else [])])
        html = _all_scores(lines, f"{board.name}, {board.kind}", notes)
        if board.held_out:
            groups = [
                (board.lines[variant].method, board.lines[variant].preset, seeds)
                for variant, seeds in grouped(list(board.members), "variant").items()
            ]
            if asked := asked_lines(groups):
                html += _asked(asked, notes)
        sections.append(
            f"<section><h3>{escape(board.name)} <small>{escape(board.kind)}</small></h3>"
            f"<p>Scene {escape(board.scene)}; dataset checksum {board.key[1][:16]}; trained on "
            f"{escape(board.trained_on)}.</p>{html}</section>"
        )
    return "".join(sections)


def column_notes() -> str:
    """What each column says."""
    return (
        '<dl class="columns">'
        + "".join(f"<dt>{escape(column.heading)}</dt><dd>{escape(column.note)}</dd>" for column in COLUMNS.values())
        + "</dl>"
    )


def run_table(collection: Collection, boards: Sequence[Board]) -> str:
    """Command, code and machine of every run; the rest is in its result.json."""
    headings = [
        Th(name, words=True)
        for name in (
            "dataset",
            "method",
            "preset",
            "seed",
            "status",
            "budget",
            "started (UTC)",
            "command",
            "key",
            "code",
            "commit",
            "left out of the method",
            "what runs, and why",
        )
    ]
    names = {board.key: board for board in boards}
    rows = []
    for entry in collection.entries:
        line = names[entry.board].lines[entry.variant]
        result = entry.result
        left = "; ".join(f"{stage}: {why}" for stage, why in result.left_out_stages.items()) if result else ""
        rows.append(
            [
                text_cell(names[entry.board].name),
                text_cell(line.method),
                text_cell(line.preset),
                Td(str(entry.spec.seed), float(entry.spec.seed), "words"),
                text_cell(str(entry.status)),
                text_cell(entry.spec.budget),
                text_cell(_minute(result.started) if result else "unknown"),
                _command(result.command) if result else text_cell("unknown"),
                text_cell(entry.spec.key[:8]),
                text_cell(entry.spec.code.rpartition("+")[2][:8]),
                text_cell(commit_text(entry) if result else "unknown"),
                text_cell(left),
                text_cell(_runs(result)),
            ]
        )
    machines = list(dict.fromkeys(machine_text(entry) for entry in collection.entries if entry.result))
    return table(headings, rows, "How each run was made") + "".join(
        f"<p>Machine: {escape(machine)}</p>" for machine in machines
    )


def _runs(result: Result | None) -> str:
    """What was decided to run, by the plan or while training, with its reason."""
    stages = result.plan.get("stages", ()) if result else ()
    return "; ".join(f"{stage['name']}: {stage['reason']}" for stage in stages if stage["runs"])


def _minute(moment: str) -> str:
    """2026-11-21T19:37:27+00:00 as 2026-11-21 19:37; results are in UTC."""
    return moment[:16].replace("T", " ")


def _command(command: str) -> Td:
    return Td(f"<code>{escape(command)}</code>", command, "words long")


def stage_table(collection: Collection, boards: Sequence[Board]) -> str:
    """Where the time of each run went."""
    names = {board.key: board for board in boards}
    timed = [entry for entry in collection.entries if entry.result is not None]
    stages = list(dict.fromkeys(stage for entry in timed for stage in entry.result.stages))
    own = list(dict.fromkeys(stage for entry in timed for stage in entry.result.method_stages))
    headings = [Th("dataset", words=True), Th("method", words=True), Th("preset", words=True), Th("seed", words=True)]
    headings += [Th(f"{stage} [s]", "harness") for stage in stages]
    headings += [Th(f"{stage} [s]", "within training") for stage in own]
    rows = []
    for entry in timed:
        line = names[entry.board].lines[entry.variant]
        times = [entry.result.stages[stage].wall if stage in entry.result.stages else None for stage in stages]
        times += [entry.result.method_stages.get(stage) for stage in own]
        rows.append(
            [
                text_cell(names[entry.board].name),
                text_cell(line.method),
                text_cell(line.preset),
                Td(str(entry.spec.seed), float(entry.spec.seed), "words"),
                *(
                    Td("not run", None, "number gap") if time is None else Td(f"{time:.2f}", time, "number")
                    for time in times
                ),
            ]
        )
    return table(headings, rows, _ABOUT_STAGES)


def _all_scores(lines: list[Line], caption: str, notes: Notes) -> str:
    empty = empty_columns(lines, SCORES)
    shown = [column for column in SCORES if column not in empty]
    best = best_texts(lines, shown)
    headings = [Th("method", words=True), Th("preset", words=True), Th("seeds", words=True)]
    headings += [score_heading(COLUMNS[column]) for column in shown]
    rows = [
        [
            text_cell(line.method),
            text_cell(line.preset),
            text_cell(line.seeds),
            *(
                score_cell(line.cells[column], COLUMNS[column], best[column] if line.competes else None, notes)
                for column in shown
            ),
        ]
        for line in lines
        if line.competes or any(line.cells[column].value is not None for column in shown)
    ]
    return table(headings, rows, caption) + not_shown(empty)


def _asked(lines: list[Line], notes: Notes) -> str:
    empty = empty_columns([Line(line.method, line.preset, line.seeds, line.cells) for line in lines], COLUMNS_SHOWN)
    shown = [column for column in COLUMNS_SHOWN if column not in empty]
    headings = [Th("method", words=True), Th("asked for", words=True)]
    headings += [score_heading(COLUMNS[column]) for column in shown]
    rows = [
        [
            text_cell(f"{line.method} {line.preset}".strip()),
            text_cell(line.seeds),
            *(score_cell(line.cells[column], COLUMNS[column], None, notes) for column in shown),
        ]
        for line in lines
    ]
    return table(headings, rows, ASKED_HEADING) + not_shown(empty)
