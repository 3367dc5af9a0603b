"""Tables of scores: the best values are marked, gaps have their reason, and empty columns are left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from dofbench.evaluation.results.columns import COLUMNS
from dofbench.reporting import standing, table_cells
from dofbench.reporting.footnotes import one_line
from dofbench.reporting.summary import Line, best_texts, empty_columns
from dofbench.reporting.view import Cell, Heading, Table


@dataclass(frozen=True)
class Beside:
    """Columns beside the scores. cells: gives a line's cells, as many as there are headings."""

    headings: tuple[Heading, ...] = ()
    cells: Callable[[Line], Sequence[Cell]] = lambda line: ()


NAMES = Beside(
    table_cells.word_headings("method", "preset", "seeds"),
    lambda line: [table_cells.words(line.method, line.signs), *map(table_cells.words, (line.preset, line.seeds))],
)
NOTHING_BESIDE = Beside()


def score_table(
    lines: Sequence[Line],
    columns: Sequence[str],
    caption: str,
    *,
    before: Beside = NAMES,
    after: Beside = NOTHING_BESIDE,
    group: str = "",
) -> Table:
    """A table of the lines in their order; below it, the columns that no line has, and why. group: heading above the
    scores."""
    empty = empty_columns(lines, columns)
    shown = [column for column in columns if column not in empty]
    best = best_texts(lines, shown)
    rows = tuple(
        (
            *before.cells(line),
            *(
                table_cells.score(line.cells[column], COLUMNS[column], best[column] if line.competes else None)
                for column in shown
            ),
            *after.cells(line),
        )
        for line in lines
        if line.competes or any(line.cells[column].value is not None for column in shown)
    )
    headings = (
        *before.headings,
        *(table_cells.score_heading(COLUMNS[column], group) for column in shown),
        *after.headings,
    )
    return Table(caption, headings, rows, below=(*not_shown(empty), *standing.notes(line.signs for line in lines)))


def not_shown(empty: Mapping[str, str], said: str = "Not shown, as no row has it") -> tuple[str, ...]:
    """A line on which columns a table leaves out, and why; none if it has all columns. empty: column -> reason, "" for
    columns that aren't mentioned."""
    reasons: dict[str, list[str]] = {}
    for column, reason in empty.items():
        if reason:
            reasons.setdefault(one_line(reason), []).append(COLUMNS[column].label)
    parts = "; ".join(f"{', '.join(labels)} ({reason})" for reason, labels in reasons.items())
    return (f"{said}: {parts}.",) if parts else ()
