"""The page's first screen: what was run, on what, how long it took, which is best, by how much and how sure."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from dofbench.core.errors import Status
from dofbench.reporting.html.boards import Board
from dofbench.reporting.html.markup import Notes, Td, Th, number_cell, score_cell, table, text_cell
from dofbench.reporting.markdown import commit_text, machine_text
from dofbench.reporting.verdict import verdict
from dofbench.results.collecting import Collection, Entry, grouped
from dofbench.results.columns import COLUMNS
from dofbench.running.method_cards import find_method, method_files


def duration(seconds: float) -> str:
    """As "2 h 05 min", "12 min" or "48 s"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def headline(collection: Collection) -> str:
    """The page in one line."""
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


def overview(collection: Collection, boards: Sequence[Board], notes: Notes) -> str:
    """Facts, and the best of every board."""
    return f'{_best(boards, notes)}<dl class="facts">{_facts(collection, boards)}</dl>'


def _best(boards: Sequence[Board], notes: Notes) -> str:
    rows = []
    for board in boards:
        found = verdict(board.lines, board.members)
        where = [text_cell(board.name), text_cell(board.kind)]
        if found is None:
            rows.append([*where, text_cell("none: every run failed, or none has a score"), *(Td(""),) * 4])
            continue
        column, line = COLUMNS[found.column], board.lines[found.best]
        best = f"{line.method} {line.preset}".strip()
        if found.second is None or found.ahead is None:
            rival, ahead = text_cell(""), Td("")
        else:
            other = board.lines[found.second]
            rival = text_cell(f"{other.method} {other.preset}".strip())
            ahead = number_cell(found.ahead, f"+{column.text(found.ahead)} {column.unit}".strip())
        mark = {True: "sure", False: "unsure", None: "untested"}[found.told_apart]
        rows.append(
            [
                *where,
                Td(f"<strong>{escape(best)}</strong>", best, "words"),
                _with_unit(line.cells[found.column], column, notes),
                rival,
                ahead,
                Td(f'<span class="{mark}">{escape(found.sure)}</span>', found.sure, "words long"),
            ]
        )
    headings = [
        Th("dataset", words=True),
        Th("protocol", words=True),
        Th("best", words=True),
        Th("PSNR", note="refocused, where any method can; else all in focus; else of photographs", down=True),
        Th("ahead of", words=True),
        Th("by", down=True),
        Th("how sure", words=True),
    ]
    return table(headings, rows, "The best of each dataset, by PSNR")


def _with_unit(cell, column, notes: Notes) -> Td:
    shown = score_cell(cell, column, None, notes)
    what = {"psnr": "refocused", "aif_psnr": "all in focus"}.get(column.id, "of photographs, fitted on half of each")
    return Td(f"{shown.html} dB<br><small>{what}</small>", shown.sort, shown.kind)


def _facts(collection: Collection, boards: Sequence[Board]) -> str:
    entries = collection.entries
    failed = [entry for entry in entries if entry.status is not Status.OK]
    facts = [
        ("What was run", [_method_words(method, entries) for method in sorted({e.spec.method for e in entries})]),
        (
            "On what",
            [
                f"{board.name} ({board.scene}): {_views(board)}; {board.kind}, trained on {board.trained_on}"
                for board in boards
            ],
        ),
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
        ("Machine", list(dict.fromkeys(machine_text(entry) for entry in entries if entry.result))),
        ("Code", list(dict.fromkeys(f"commit {commit_text(entry)}" for entry in entries if entry.result))),
    ]
    return "".join(f"<dt>{escape(name)}</dt><dd>{_list(items)}</dd>" for name, items in facts if items)


def _list(items: list[str]) -> str:
    if len(items) == 1:
        return escape(items[0])
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


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
    counts = sorted({len(seeds) for board in boards for seeds in grouped(list(board.members), "variant").values()})
    if counts == [1]:
        return "one a row: no spread is known, so small differences say nothing"
    span = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"{span} a row; cells are mean ± sample standard deviation over them"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
