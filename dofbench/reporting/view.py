"""What a report says, before anybody has decided how it looks: tables, lists and sections as plain data.

Everything in here is settled when it is built: numbers are text with their digits, verdicts are words, the best of a
column is marked, a gap has its reason. The writers (`markdown_writer`, `html`, `csv_writer`) lay it out and compute
nothing, so no two of them can say different things.

The text of a `Paragraph`, of `Items` and of the lines below a table may hold `code`, *emphasis* and **strong**; every
other text is plain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

GAP = "–"

# number: a figure. gap: none, for a reason. failed: none, as a run failed. words: text. published: a figure that
# authors printed. sure, unsure, untested: words that a test bears, doesn't bear, or doesn't reach.
Kind = Literal["number", "gap", "failed", "words", "published", "sure", "unsure", "untested"]


@dataclass(frozen=True)
class DifferenceTest:
    """What stands behind a difference. interval: as "[+0.12, +0.50]", "" where views are too few. p: as "p = 0.003", ""
    where there is nothing to test. verdict: better, worse, more, less, or "" where nothing can be said. one_seed:
    whether either side was trained only once. pairs: how many differences it is the mean of. spread: their sample
    standard deviation, "" for a single one."""

    interval: str
    p: str
    verdict: str
    one_seed: bool
    pairs: int
    spread: str


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    text: as it is shown. sort: what it sorts by; None sorts last, whichever way. spread: what stands behind ±, "" for
    none. best: whether it is the best of its column. reason: why there is no number, of a gap or a failure. code: shown
    as code in place of the text. unit: behind the spread, where the heading doesn't say it. below: a second line, in
    small print. test: of a difference.
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
    """The heading of a column. group: the heading above it, shared with its neighbours. note: what the column says.
    largest_first: how it is sorted first. words: whether its cells are text. published: whether its figures are printed
    ones. wide: whether it stands only where there is room for many columns."""

    text: str
    group: str = ""
    note: str = ""
    largest_first: bool = False
    words: bool = False
    published: bool = False
    wide: bool = False


@dataclass(frozen=True)
class Table:
    """names: how many of the first cells name a row. below: lines that stand below it, such as the columns that it
    leaves out."""

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
    """A picture by reference. file: relative to the report's folder. says: what it shows."""

    file: str
    says: str
    type: Literal["picture"] = "picture"


@dataclass(frozen=True)
class Section:
    """A title and what stands below it."""

    title: str
    blocks: tuple[Block, ...]
    type: Literal["section"] = "section"


Block = Table | Paragraph | Items | Command | Picture | Section


@dataclass(frozen=True)
class Document:
    """A page of its own. id: what its files are called."""

    id: str
    title: str
    blocks: tuple[Block, ...]
