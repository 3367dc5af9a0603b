"""The numbers of a Markdown page: where they stand, in sentences and in tables, and whether one agrees with a value."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

# Thousands are set apart by a space; a sign counts unless it joins two words, as in "a 9-view set".
NUMBER = re.compile(
    r"(?<![\w.#])(?<![A-Za-z]-)(?:(?<![\w)])[+\-−])?"
    r"(?:\d{1,3}(?: \d{3})+(?!\d)|\d+(?:\.\d+)?(?:e[+\-−]?\d+)?)(?![\w]|\.\d)"
)
_SETTING = r"(?:0|0\.2|0\.5|0\.8|1|1\.0|1\.5)"  # of an aperture or a focus, in the datasets that the pages are about
# Numbers that name or set something, on every page; whatever else isn't measured is declared page by page.
NAMES = re.compile(
    rf"""(?:Tables?|Eq\.|Eqs\.|rows?|[Ss]eeds?|Zen|section|Algorithm|Python)\s\d+(?:\.\d+)*(?:(?:,|\sand|\sto|\sor)\s\d+)*
    | \b(?=[0-9a-f]*[0-9])[0-9a-f]{{7}}\b                                            # commits
    | \d+\s[×x]\s\d+(?:\s[×x]\s\d+)?                                            # sizes in pixels
    | \d[\d\s]*\ssteps | \d+\s(?:px|pixels)\swide | f/\d+(?:\.\d+)?
    | \b[AF]\s(?:=\s|of\s|dealt\sfrom\s)?{_SETTING}(?:,?(?:\sand|\sor)?\s{_SETTING})*(?![.\d])
    | \b[AF]\s∈\s\{{[^}}]*\}}""",
    re.VERBOSE,
)
_FENCE = re.compile(r"^(?:<!-- .*? -->\n)?```\w*\n.*?^```$", re.MULTILINE | re.DOTALL)
_INDENTED = re.compile(r"(?:^    .*\n?)+", re.MULTILINE)
_LINK = re.compile(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\([^)\s]+\)")
_CODE = re.compile(r"`[^`\n]*`")
_RULE = re.compile(r"^\|[\s:|-]+\|$")


@dataclass(frozen=True)
class Table:
    """A table of a page. head: its first line, as written. rows: the texts of the cells of each row below the rule."""

    head: str
    rows: tuple[tuple[str, ...], ...] = field(repr=False)


@dataclass(frozen=True)
class Figure:
    """A number on a page: its text, and where it starts and ends in the text that it stands in."""

    said: str
    start: int
    end: int


def numbers(text: str) -> Iterator[Figure]:
    """The numbers of a text, in order."""
    for found in NUMBER.finditer(text):
        yield Figure(found.group(), found.start(), found.end())


def plain(text: str) -> str:
    """A text in one line, without emphasis and targets of links; digits of code count as none."""
    text = " ".join(_LINK.sub(r"\1", text).split())
    text = _CODE.sub(lambda code: re.sub(r"\d", "_", code.group()), text)
    return text.replace("**", "")


def sentences(page: str) -> str:
    """A page without tables, code blocks and comments, as `plain` makes it."""
    text = re.sub(r"<!--.*?-->", "", _FENCE.sub("", page), flags=re.DOTALL)
    lines = ("" if line.startswith("|") else line for line in _INDENTED.sub("\n", text).splitlines())
    return plain("\n".join(lines))


def tables(page: str) -> list[Table]:
    """The tables of a page, in order."""
    found: list[Table] = []
    block: list[str] = []
    for line in [*_FENCE.sub("", page).splitlines(), ""]:
        if line.startswith("|"):
            block.append(line.rstrip())
        elif block:
            rule = next(number for number, text in enumerate(block) if _RULE.match(text))
            found.append(Table(block[0], tuple(_cells(text) for text in block[rule + 1 :])))
            block = []
    return found


def number_of(said: str) -> float:
    """The number that a figure says."""
    return float(said.replace(" ", "").replace("−", "-"))


def agrees(said: str, known: float) -> bool:
    """Whether a figure is the value, rounded to the digits that the figure has."""
    mantissa, _, power = said.replace("−", "-").partition("e")
    unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return abs(number_of(said) - known) <= 0.5 * unit * (1 + 1e-9) + 1e-12 * abs(known)


def _cells(line: str) -> tuple[str, ...]:
    return tuple(plain(cell).strip(" *") for cell in line.strip("|").split("|"))
