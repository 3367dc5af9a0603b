"""The content of a report independent of its format: tables, lists and sections as plain data.

The data are final: numbers are rounded text, verdicts are words, the best of a column is marked, a gap has its reason.
The writers (`markdown_writer`, `html`, `csv_writer`) only format them and compute nothing, so their contents always
agree.

The text of a `Paragraph`, of `Items` and of the lines below a table may hold `code`, *emphasis* and **strong**; every
other text is plain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

GAP = "–"

# Kinds of cells. number: a figure. gap: no figure, with a reason. failed: no figure, because a run failed. words: text.
# published: a figure that authors published. sure, unsure, untested: a statement that a test confirms, doesn't confirm,
# or that wasn't tested.
Kind = Literal["number", "gap", "failed", "words", "published", "sure", "unsure", "untested"]


@dataclass(frozen=True)
class DifferenceTest:
    """The statistics of a difference, as text. interval: such as "[+0.12, +0.50]", "" with too few views. p: such as "p
    = 0.003", "" if there is nothing to test. verdict: better, worse, more, less, or "" if the difference isn't
    significant. one_seed: whether one of the sides was trained only once. pairs: number of paired differences. spread:
    their sample standard deviation, "" for a single pair."""

    interval: str
    p: str
    verdict: str
    one_seed: bool
    pairs: int
    spread: str


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    text: as shown. sort: sort key; None sorts last in both directions. spread: the number after ±, "" without. best:
    whether the cell is the best of its column. reason: why a gap or failure has no number. code: shown as code instead
    of the text. unit: shown after the spread if the heading doesn't have it. below: a second line in small print. test:
    statistics of a difference.
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


@dataclass(frozen=True)
class Heading:
    """The heading of a column. group: a heading above it, shared with neighbouring columns. note: explanation of the
    column. largest_first: direction of the first sort. words: whether its cells are text. published: whether its
    figures were published by authors. wide: whether the column is shown only by writers with room for many columns."""

    text: str
    group: str = ""
    note: str = ""
    largest_first: bool = False
    words: bool = False
    published: bool = False
    wide: bool = False


@dataclass(frozen=True)
class Table:
    """A table. names: number of leading cells that name a row. below: lines below the table, such as those on columns
    that it leaves out."""

    caption: str
    headings: tuple[Heading, ...]
    rows: tuple[tuple[Cell, ...], ...]
    names: int = 1
    below: tuple[str, ...] = ()
    type: Literal["table"] = "table"


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str
    type: Literal["paragraph"] = "paragraph"


@dataclass(frozen=True)
class Items:
    """A list, one line each."""

    items: tuple[str, ...]
    type: Literal["items"] = "items"


@dataclass(frozen=True)
class Command:
    """A command line, to be copied."""

    text: str
    type: Literal["command"] = "command"


@dataclass(frozen=True)
class Picture:
    """A picture by its file. file: relative to the report's folder. says: description of the picture."""

    file: str
    says: str
    type: Literal["picture"] = "picture"


@dataclass(frozen=True)
class Section:
    """A title with its blocks."""

    title: str
    blocks: tuple[Block, ...]
    type: Literal["section"] = "section"


Block = Table | Paragraph | Items | Command | Picture | Section


@dataclass(frozen=True)
class Document:
    """A complete page. id: stem of its file names."""

    id: str
    title: str
    blocks: tuple[Block, ...]
