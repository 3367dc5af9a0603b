"""Lines of scores as a Markdown table: the best in bold, gaps with their reason, no column that is empty throughout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from dofbench.reporting.footnotes import Footnotes, table
from dofbench.reporting.summary import Line, best_texts, empty_columns
from dofbench.results.columns import COLUMNS, Column


@dataclass(frozen=True)
class Beside:
    """Columns beside the scores. cells: of a line, as many as headings."""

    headings: list[str] = field(default_factory=list)
    cells: Callable[[Line], list[str]] = lambda line: []


def line_table(
    lines: Sequence[Line],
    columns: Sequence[str],
    notes: Footnotes,
    *,
    before: Beside,
    after: Beside | None = None,
) -> list[str]:
    """The lines in their order, and below them which columns no line has, and why."""
    after = after or Beside()
    empty = empty_columns(lines, columns)
    shown = [column for column in columns if column not in empty]
    best = best_texts(list(lines), shown)
    kept = [line for line in lines if line.competes or any(line.cells[column].value is not None for column in shown)]
    rows = [
        [*before.cells(line), *(cell_text(line, column, best[column], notes) for column in shown), *after.cells(line)]
        for line in kept
    ]
    heading = [*before.headings, *(COLUMNS[column].heading for column in shown), *after.headings]
    return [*table(heading, rows, left=len(before.headings)), *_not_shown(empty)]


def cell_text(line: Line, column: str, best: str | None, notes: Footnotes, known: Column | None = None) -> str:
    """A cell as it is shown, with a footnote where it has no number. known: the column, where it is no score's."""
    cell, known = line.cells[column], known or COLUMNS[column]
    if cell.value is None:
        return (cell.failure or "–") + notes.mark(cell.reason)
    text = known.text(cell.value)
    shown = text if cell.spread is None else f"{text} ± {known.text(cell.spread)}"
    return f"**{shown}**" if line.competes and text == best else shown


def plain(text: str) -> str:
    """Text that can stand in a cell."""
    return text.replace("|", "\\|")


def _not_shown(empty: dict[str, str]) -> list[str]:
    reasons: dict[str, list[str]] = {}
    for column, reason in empty.items():
        if not reason:
            continue
        reasons.setdefault(reason, []).append(COLUMNS[column].label)
    if not reasons:
        return []
    parts = [f"{', '.join(labels)} ({plain(' '.join(reason.split()))})" for reason, labels in reasons.items()]
    return ["", f"Not shown, as no row has it: {'; '.join(parts)}."]
