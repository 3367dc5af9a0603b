"""The content of a page as plain data: sections, tables and cells, and how scores become cells.

The data are final: numbers are rounded text, verdicts are words, the best of a column is marked, a gap has its reason.
Templates only format them. Paragraphs, list items and the lines below a table may hold `code`, *emphasis* and
**strong**; every other text is plain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

from dofbench.evaluation.comparing.means import Statistic
from dofbench.evaluation.comparing.paired import Compared
from dofbench.evaluation.results.columns import COLUMNS, Column
from dofbench.reporting.boards import NOTES, Line, best_texts, empty_columns, united

GAP = "–"
_LONG = 40  # characters: a column of words at least this long gets a minimum width
_PUBLISHED_DIGITS = 3  # decimals of a printed SSIM

# number: a figure. gap, failed: none, with a reason. words: text. published: a figure of the authors. sure, unsure,
# untested: a statement that a test confirms, doesn't confirm, or that wasn't tested.
Kind = Literal["number", "gap", "failed", "words", "published", "sure", "unsure", "untested"]


@dataclass(frozen=True)
class DifferenceTest:
    """The statistics of a difference as text; "" where there are none. wins: on how many views the first is the better.
    one_seed: whether a side was trained only once. spread: standard deviation of the `units` single differences."""

    interval: str
    p: str
    verdict: str
    one_seed: bool
    units: int
    spread: str
    wins: str = ""


@dataclass(frozen=True)
class Cell:
    """One cell. sort: sort key, None sorts last. spread: the number after ±. best: of its column. reason: of a gap or
    failure. code: shown as code instead of the text. unit: shown after the spread. below: second line in small print.
    signs: those in the text, explained below the table (`boards.NOTES`). link: the folder of a report's pages, to which
    the text leads.
    """

    text: str
    kind: Kind = "words"
    sort: float | str | None = None
    spread: str = ""
    best: bool = False
    reason: str = ""
    code: tuple[str, ...] = ()
    unit: str = ""
    below: str = ""
    test: DifferenceTest | None = None
    signs: str = ""
    link: str = ""

    @property
    def long(self) -> bool:
        """Whether its column needs a minimum width."""
        return any(len(text) > _LONG for text in (self.text, *self.code))

    @property
    def sort_text(self) -> str:
        """The sort key as JavaScript reads it; "" where there is none, or it is the text."""
        if isinstance(self.sort, str):
            return "" if self.sort.lower() in (self.text.lower(), " ".join(self.code).lower()) else self.sort
        return "" if self.sort is None else f"{self.sort:.8g}".replace("inf", "Infinity")


@dataclass(frozen=True)
class Heading:
    """The heading of a column. group: shared heading above neighbouring columns. note: explanation. largest_first:
    direction of the first sort. words: whether its cells are text. published: whether its figures are the authors'.
    wide: shown only on pages with room for many columns."""

    text: str
    group: str = ""
    note: str = ""
    largest_first: bool = False
    words: bool = False
    published: bool = False
    wide: bool = False


@dataclass(frozen=True)
class Table:
    """A table. names: number of leading cells that name a row. below: lines below the table. theirs: number of rows at
    the end that only the paper has. rest: what has all rows, where a page shows the first of them."""

    caption: str
    headings: tuple[Heading, ...]
    rows: tuple[tuple[Cell, ...], ...]
    names: int = 1
    below: tuple[str, ...] = ()
    theirs: int = 0
    rest: str = ""

    def first(self, most: int) -> Table:
        """The table with at most so many rows besides those that only the paper has; a line below says so."""
        own = len(self.rows) - self.theirs
        if own <= most:
            return self
        said = f"The first {most} of {own} rows{f'; `{self.rest}` has all' if self.rest else ''}."
        return replace(self, rows=self.rows[:most] + self.rows[own:], below=(said, *self.below))

    def without_empty(self, *, wide: bool = True) -> Table:
        """The table without columns in which every cell is empty, and without wide columns unless `wide`."""
        kept = [
            place
            for place, heading in enumerate(self.headings)
            if (wide or not heading.wide)
            and (not self.rows or any(row[place].text or row[place].code for row in self.rows))
        ]
        rows = tuple(tuple(row[place] for place in kept) for row in self.rows)
        names = sum(place < self.names for place in kept)
        return replace(self, headings=tuple(self.headings[place] for place in kept), rows=rows, names=names)

    @property
    def notes(self) -> tuple[str, ...]:
        """The lines below the table, then what the signs in it mean."""
        return (*self.below, *(NOTES[sign] for sign in united(cell.signs for row in self.rows for cell in row)))

    @property
    def left(self) -> int:
        """Number of leading columns of text."""
        return next((place for place, heading in enumerate(self.headings) if not heading.words), len(self.headings))

    @property
    def groups(self) -> list[tuple[str, int]]:
        """(group, number of its columns) from left to right."""
        return [(group, len(list(own))) for group, own in groupby(self.headings, lambda one: one.group)]

    @property
    def edges(self) -> set[int]:
        """The columns at which a named group begins."""
        starts = [0]
        for _, count in self.groups:
            starts.append(starts[-1] + count)
        return {start for start, (group, _) in zip(starts, self.groups, strict=False) if group}


@dataclass(frozen=True)
class Section:
    """A titled part of a page, shown in the order of its fields. id: file name of a page of its own."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    command: str = ""
    items: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()
    id: str = ""

    def first(self, most: int) -> Section:
        """The section with at most so many rows in each table (`Table.first`)."""
        tables = tuple(table.first(most) for table in self.tables)
        return replace(self, tables=tables, sections=tuple(section.first(most) for section in self.sections))


# ---- cells ----


def words(text: str, signs: str = "") -> Cell:
    """A cell of text with signs behind it (`boards.NOTES`), sorted by the text."""
    return Cell(f"{text} {signs}".strip(), sort=text.lower(), signs=signs)


def cells(*texts: str | Cell) -> tuple[Cell, ...]:
    """A row; plain text becomes cells of text."""
    return tuple(words(text) if isinstance(text, str) else text for text in texts)


def number(value: float, text: str) -> Cell:
    """A number shown as `text` and sorted by its value; NaN sorts last."""
    return Cell(text, "number", None if math.isnan(value) else value)


def gap(reason: str) -> Cell:
    """A cell without a number, with the reason."""
    return Cell(GAP, "gap", reason=reason)


def score(found: Statistic, column: Column, best: str | None = None) -> Cell:
    """A score with its spread. best: the best value of its column as shown."""
    if found.value is None:
        return Cell(found.failure, "failed", reason=found.reason) if found.failure else gap(found.reason)
    text = column.text(found.value)
    spread = "" if found.spread is None else column.text(found.spread)
    return replace(number(found.value, text), spread=spread, best=text == best)


def published(value: float | None, column: Column, silent: str) -> Cell:
    """A figure of the authors with as many digits as published; for None a gap with the reason `silent`."""
    if value is None:
        return gap(silent)
    return Cell(f"{value:.{min(column.digits, _PUBLISHED_DIGITS)}f}", "published", value)


def difference(compared: Compared) -> Cell:
    """A difference with interval, wins, p and verdict, or a gap. A difference that is shown as zero has no verdict."""
    found, column = compared.difference, COLUMNS[compared.column]
    if found is None:
        return gap(compared.reason)
    text, *ends = (f"{value:+.{column.digits}f}" for value in (found.mean, found.low, found.high) if value is not None)
    wins = {True: found.above, False: found.below, None: None}[column.higher_is_better]
    tested = DifferenceTest(
        interval=f"[{', '.join(ends)}]" if ends else "",
        p="" if found.p is None else "p < 0.001" if found.p < 0.001 else f"p = {found.p:.3f}",
        verdict="" if float(text) == 0 else compared.verdict,
        one_seed=found.seeds < 2,
        units=found.units,
        spread="" if found.spread is None else column.text(found.spread),
        wins="" if wins is None else f"{wins} of {found.pairs}",
    )
    return replace(number(found.mean, text), test=tested)


def score_headings(columns: Iterable[str], group: str = "", *, published: bool = False) -> tuple[Heading, ...]:
    """Headings of scores, with unit, direction and how they are measured."""
    known = (COLUMNS[column] for column in columns)
    return tuple(
        Heading(one.heading, group, one.note, bool(one.higher_is_better), published=published) for one in known
    )


def word_headings(*texts: str, wide: bool = False) -> tuple[Heading, ...]:
    """Headings of columns of text."""
    return tuple(Heading(text, words=True, wide=wide) for text in texts)


# ---- tables of scores ----


@dataclass(frozen=True)
class Extra:
    """Columns next to the scores. cells: a line's cells, as many as headings."""

    headings: tuple[Heading, ...] = ()
    cells: Callable[[Line], Sequence[Cell]] = lambda line: ()


NAMES = Extra(
    word_headings("method", "preset", "seeds"),
    lambda line: (words(line.method, line.signs), *cells(line.preset, line.seeds)),
)


def score_table(
    lines: Sequence[Line],
    columns: Sequence[str],
    caption: str,
    *,
    before: Extra = NAMES,
    after: Extra = Extra(),
    group: str = "",
    more: Sequence[tuple[Cell, ...]] = (),
    below: Sequence[str] = (),
) -> Table:
    """A table of the lines in their order; below it, the columns that no line has, and `below`.
    group: heading above the scores. more: rows that only the paper has."""
    empty = empty_columns(lines, columns)
    shown = [column for column in columns if column not in empty]
    best = best_texts(lines, shown)

    def scores(line: Line) -> list[Cell]:
        marked = best if line.competes else {}
        return [score(line.cells[column], COLUMNS[column], marked.get(column)) for column in shown]

    rows = tuple(
        (*before.cells(line), *scores(line), *after.cells(line))
        for line in lines
        if line.competes or any(line.cells[column].value is not None for column in shown)
    )
    headings = (*before.headings, *score_headings(shown, group), *after.headings)
    below = (*not_shown(empty), *below)
    return Table(caption, headings, (*rows, *more), below=below, theirs=len(more), rest="leaderboard.csv")


def not_shown(empty: Mapping[str, str], said: str = "Not shown, as no row has it") -> tuple[str, ...]:
    """A line on the columns that a table omits, and why. empty: column -> reason, "" for columns not mentioned."""
    reasons: dict[str, list[str]] = {}
    for column, reason in empty.items():
        if reason:
            reasons.setdefault(one_line(reason), []).append(COLUMNS[column].label)
    parts = "; ".join(f"{', '.join(labels)} ({reason})" for reason, labels in reasons.items())
    return (f"{said}: {parts}.",) if parts else ()


def one_line(text: str) -> str:
    """The text without line breaks, which cells and footnotes can't contain."""
    return " ".join(text.split())
