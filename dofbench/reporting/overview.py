"""The report's first screen: methods, datasets, times, and the best over scenes and on each dataset, with its lead and
how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Collection, Entry
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.methods.cards import find_method, method_files
from dofbench.reporting import standing, table_cells
from dofbench.reporting.boards import Board, Variant, by_kind, mean_lines
from dofbench.reporting.how_made import commit_text, machine_text
from dofbench.reporting.points_seen import points_facts
from dofbench.reporting.summary import Line
from dofbench.reporting.verdict import HEADLINES, verdicts
from dofbench.reporting.view import Cell, Heading, Table

_SCORED_ON = {"psnr": "refocused", "aif_psnr": "all in focus"}
_PHOTOGRAPHS = "of photographs, fitted on half of each"
_COSTS = {"train_s": "s of training", "render_fps": "frames/s"}


def duration(seconds: float) -> str:
    """A duration such as "2 h 05 min", "12 min" or "48 s"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def headline(collection: Collection) -> str:
    """A summary of the page in one line."""
    entries = collection.entries
    methods, datasets = {entry.spec.method for entry in entries}, {entry.board[:2] for entry in entries}
    parts = [
        _count(len(entries), "run"),
        _count(len(methods), "method"),
        _count(len(datasets), "dataset"),
        f"{duration(_trained(entries))} of training",
    ]
    days = sorted({entry.result.ended[:10] for entry in entries if entry.result})
    if days:
        parts.append(days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}")
    return " · ".join(parts)


def best_table(boards: Sequence[Board]) -> Table:
    """The best row of the means over each kind's boards, and of every board."""
    rows: list[tuple[Cell, ...]] = []
    for kind, scenes in by_kind(boards).items():
        if len(scenes) > 1:
            means = mean_lines(scenes, [*(column for columns in HEADLINES for column in columns), *_COSTS])
            rows += _rows(f"mean over {len(scenes)} scenes", kind, means, [board.variants for board in scenes])
    for board in boards:
        rows += _rows(board.name, board.kind, board.lines, [board.variants]) or [_nobody(board)]
    headings = (
        *table_cells.word_headings("dataset", "protocol", "best"),
        Heading("PSNR", note="refocused, all in focus, or of photographs", largest_first=True),
        *table_cells.word_headings("ahead of"),
        Heading("by", largest_first=True),
        *table_cells.word_headings("how sure", "at what cost"),
    )
    below = standing.notes(line.signs for board in boards for line in board.lines.values())
    return Table("The best over scenes and of each dataset, by PSNR", headings, tuple(rows), below=below)


def _rows(
    name: str, kind: str, lines: dict[Variant, Line], boards: Sequence[dict[Variant, list[Entry]]]
) -> list[tuple[Cell, ...]]:
    """A row for everything that one can be the best at."""
    signs = standing.united(line.signs for line in lines.values())
    rows: list[tuple[Cell, ...]] = []
    for found in verdicts(lines, boards):
        column, first = COLUMNS[found.column], lines[found.best]
        shown = table_cells.score(first.cells[found.column], column)
        rival, ahead = Cell(""), Cell("")
        if found.second is not None and found.ahead is not None:
            rival = table_cells.words(lines[found.second].name, lines[found.second].signs)
            ahead = table_cells.number(found.ahead, f"+{column.text(found.ahead)} {column.unit}".strip())
        rows.append(
            (
                table_cells.words(name, signs),
                table_cells.words(kind),
                Cell(table_cells.signed(first.name, first.signs), sort=first.name, best=True),
                replace(shown, unit="dB", below=_SCORED_ON.get(column.id, _PHOTOGRAPHS)),
                rival,
                ahead,
                found.sure,
                table_cells.words(_cost(first)),
            )
        )
    return rows


def _nobody(board: Board) -> tuple[Cell, ...]:
    signs = standing.united(line.signs for line in board.lines.values())
    said = table_cells.words("none: every run failed, or none has a score")
    return (table_cells.words(board.name, signs), table_cells.words(board.kind), said, *(Cell(""),) * 5)


def _cost(line: Line) -> str:
    """Such as "60 s of training, 24.1 frames/s"; what isn't known is left out."""
    known = [(COLUMNS[column], line.cells[column].value, says) for column, says in _COSTS.items()]
    return ", ".join(f"{column.text(value)} {says}" for column, value, says in known if value is not None)


def facts(collection: Collection, boards: Sequence[Board]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """(term, lines) on what was run, on which datasets, how long it took, and what failed; terms without lines are left
    out."""
    entries = collection.entries
    failed = [entry for entry in entries if entry.status is not Status.OK]
    found = [
        ("What was run", [_method_words(method, entries) for method in sorted({e.spec.method for e in entries})]),
        (
            "On what",
            [
                f"{board.name} ({board.scene}): {_views(board)}; {board.kind}, trained on {board.trained_on}"
                for board in boards
            ],
        ),
        ("What methods start from", points_facts([(board.name, board.members) for board in boards])),
        ("How long it took", [_time_words(entries)]),
        ("Seeds", [_seed_words(boards)]),
        (
            "What failed",
            [
                f"{entry.spec.method} {entry.preset} on {entry.spec.dataset}, seed {entry.spec.seed}: "
                f"{entry.status}: {entry.message}"
                for entry in failed
            ]
            or ["nothing"],
        ),
        (
            "Not counted",
            [
                *(f"{folder}: a run is at work there" for folder in collection.running),
                *(f"{folder}: a copy of another result" for folder in collection.doubles),
                *(f"unreadable: {problem}" for problem in collection.unreadable),
            ],
        ),
        ("Machine", list(dict.fromkeys(machine_text(entry.result) for entry in entries if entry.result))),
        ("Code", list(dict.fromkeys(f"commit {commit_text(entry.result)}" for entry in entries if entry.result))),
    ]
    return tuple((term, tuple(lines)) for term, lines in found if lines)


def _method_words(method: str, entries: Sequence[Entry]) -> str:
    presets = list(dict.fromkeys(entry.preset for entry in entries if entry.spec.method == method))
    shown = ", ".join(presets[:4]) + (f" and {len(presets) - 4} more" if len(presets) > 4 else "")
    about = f": {find_method(method).card.summary}" if method in method_files() else ""
    return f"{method} ({_count(len(presets), 'preset')}: {shown}){about}"


def _views(board: Board) -> str:
    plan = next((entry.result.plan for entry in board.members if entry.result), None)
    return "unknown views" if plan is None else f"{plan['train_views']} training and {plan['test_views']} test views"


def _time_words(entries: Sequence[Entry]) -> str:
    whole = sum(stage.wall for entry in entries if entry.result for stage in entry.result.stages.values())
    cpu = sum(entry.result.stages["train"].cpu for entry in entries if entry.result and "train" in entry.result.stages)
    cold = sum(
        entry.result.stages[stage].wall
        for entry in entries
        if entry.result
        for stage in ("import", "warm up")
        if stage in entry.result.stages
    )
    return (
        f"training {duration(_trained(entries))} wall, {duration(cpu)} CPU; cold start {duration(cold)}; "
        f"everything with scoring {duration(whole)}"
    )


def _trained(entries: Sequence[Entry]) -> float:
    return sum(entry.scores.get("train_s", 0.0) for entry in entries)


def _seed_words(boards: Sequence[Board]) -> str:
    counts = sorted({len(seeds) for board in boards for seeds in board.variants.values()})
    if counts == [1]:
        return "one a row: no spread is known, so small differences say nothing"
    span = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"{span} a row; cells are mean ± sample standard deviation over them"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
