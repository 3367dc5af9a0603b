"""Pages with figures, and what each figure is tied to: the `figures.toml` beside them.

    settings = ["rules.md"]             # pages that state limits and other people's figures alone; of docs/ only
    [default]                           # of all pages of this file, unless a page says otherwise
    commits = ["217b1e9"]               # that made the figures
    machine = "two cores, nothing else running"

    [[page]]
    file = "README.md"
    commands = ["dofbench ..."]         # that made the figures, if the page doesn't say them
    not_measured = ["of 12 pairs"]      # texts whose numbers are settings, names or other people's figures
    [page.rows]                         # names for rows of a CSV; `by` picks rows by name: fern.psnr.mean
    fern = { csv = "board.csv", method = "dofgaussian", by = "column" }
    [[page.table]]
    head = "| scene | PSNR |"           # how the table's first line begins
    from = { csv = "board.csv" }        # what the rows have in common
    # A row: keys, one of page.rows, a list of columns of its own, or "", not measured
    rows = [{ scene = "fern" }, "flower", ""]
    columns = ["", "psnr; ssim"]        # the values of a cell's numbers, in order; "": not measured
    # With `each` in place of `rows`, the whole table follows: `benchmarks/figure_tables.py`
    [[page.sentence]]
    text = "fern has <31.39> dB, <0.2> dB more than before"
    is = ["fern.psnr.mean", "fern.psnr.mean - before.psnr"]     # "under x", "over x": a bound of x

    [[generated]]                       # a table that a command writes from its CSV
    file = "board.md"
    csv = ["board.csv"]
    tables = ["| method |"]             # whose numbers must be in the CSV, digit by digit

Values are Python expressions: `benchmarks/figure_values.py`. Every number of a page is in a table, in angle brackets of
a sentence, in `not_measured`, or is a name or size that all pages know (`NAMES` in `benchmarks/figure_numbers.py`).
"""

from __future__ import annotations

import bisect
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import figure_tables
from figure_numbers import NAMES, Figure, Table, agrees, number_of, numbers, plain, sentences, tables
from figure_values import NoSuchValue, Rows, csv_values, evaluate, select

QUANTITY = re.compile(r"\d (?:dB|ms|s|min|GB|MB)\b")  # what a page of docs/ measures, if it measures anything
_TIED = re.compile(r"<([^<>\s][^<>]*)>")
_KEYS = {"file", "commits", "machine", "commands", "not_measured", "rows", "table", "sentence", "csv", "tables"}


@dataclass(frozen=True)
class Page:
    """A page and its ties. folder: of its figures.toml; given: the entry there, with the defaults. generated: whether a
    command writes it."""

    folder: Path
    given: dict[str, Any]
    generated: bool = False

    @property
    def file(self) -> Path:
        """The page."""
        return (self.folder / self.given["file"]).resolve()

    @cached_property
    def text(self) -> str:
        """What the page says."""
        return self.file.read_text(encoding="utf-8")

    @cached_property
    def names(self) -> dict[str, Rows]:
        """The page's names for rows of CSV files."""
        return {name: select(self.folder, chosen) for name, chosen in self.given.get("rows", {}).items()}


def read_pages(root: Path) -> list[Page]:
    """The pages of every figures.toml below reports/ and docs/."""
    files = sorted(file for folder in ("reports", "docs") for file in (root / folder).rglob("figures.toml"))
    return [page for file in files for page in pages_of(file)]


def pages_of(file: Path) -> list[Page]:
    """The pages of one figures.toml. Raises ValueError for keys that it doesn't know."""
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    default = data.get("default", {})
    found = []
    for kind in ("page", "generated"):
        for entry in data.get(kind, []):
            if unknown := set(entry) - _KEYS:
                raise ValueError(f"{file}: {entry.get('file')}: unknown {', '.join(sorted(unknown))}")
            found.append(Page(file.parent, {**default, **entry}, kind == "generated"))
    return found


def settings(file: Path) -> list[str]:
    """The pages beside a figures.toml that state limits and other people's figures alone."""
    return list(tomllib.loads(file.read_text(encoding="utf-8")).get("settings", []))


def problems(page: Page) -> Iterator[str]:
    """What is wrong with the figures of a page, a line each."""
    try:
        if page.generated:
            yield from _in_csv(page)
        else:
            yield from _in_tables(page)
            yield from _in_sentences(page)
    except NoSuchValue as error:
        yield str(error)


# ---- sentences ----


def _in_sentences(page: Page) -> Iterator[str]:
    text = sentences(page.text)
    covered = [found.span() for found in NAMES.finditer(text)]
    for words in page.given.get("not_measured", []):
        spans = _spans(plain(words), text)
        if not spans:
            yield f"not_measured {words!r}: the page doesn't say so"
        covered += spans
    for entry in page.given.get("sentence", []):
        bare, figures = _bare(plain(entry["text"]))
        spans = _spans(bare, text)
        if len(spans) != 1:
            yield f"{bare!r}: stands {len(spans)} times on the page, expected once"
            continue
        covered += spans
        if len(figures) != len(entry["is"]):
            yield f"{bare!r}: {len(figures)} figures in angle brackets, but {len(entry['is'])} values"
            continue
        for figure, expression in zip(figures, entry["is"], strict=True):
            bound, words = _bound(expression)
            yield from _compare(figure, evaluate(words, page.names), f"{bare!r}: {expression}", bound)
    for figure in numbers(text):
        if not any(start <= figure.start and figure.end <= end for start, end in covered):
            around = text[max(0, figure.start - 50) : figure.end + 30]
            yield f"{figure.said} in {around!r} is tied to no value, nor declared as not measured"


def _bare(words: str) -> tuple[str, list[str]]:
    """A sentence without its angle brackets, and the figures that they hold."""
    return _TIED.sub(r"\1", words), _TIED.findall(words)


def _spans(words: str, text: str) -> list[tuple[int, int]]:
    return [found.span() for found in re.finditer(re.escape(words), text)]


def _bound(expression: str) -> tuple[str, str]:
    """("under" or "over" or "", the rest) of a value that a figure is a bound of, as "under fern.p" for "p < 0.01"."""
    first, _, rest = expression.partition(" ")
    return (first, rest) if first in ("under", "over") else ("", expression)


def _compare(said: str, known: Any, where: str, bound: str = "") -> Iterator[str]:
    figure = list(numbers(said))
    if len(figure) != 1 or figure[0].said != said.strip():
        yield f"{where}: {said!r} is not one number"
    elif not isinstance(known, (int, float)):
        yield f"{where}: the page says {said}, the CSV {'nothing' if known is None else known}"
    elif not (_holds(said, known, bound) if bound else agrees(said, known)):
        yield f"{where}: the page says {said}, the CSV {known:g}"


def _holds(said: str, known: float, bound: str) -> bool:
    limit = number_of(said)
    return known <= limit if bound == "under" else known >= limit


# ---- tables ----


def _in_tables(page: Page) -> Iterator[str]:
    left = tables(page.text)
    for entry in page.given.get("table", []):
        found = [table for table in left if table.head.startswith(entry["head"])]
        if not found:
            yield f"table {entry['head']!r}: the page has none, or fewer"
            continue
        left.remove(found[0])
        yield from (_whole if "each" in entry else _in_table)(page, entry, found[0])
    for table in left:
        for row in table.rows:
            for cell in row:
                if figure := _measured(cell):
                    yield f"table {table.head!r}: {figure[0].said} in {cell!r} is tied to no value"


def _in_table(page: Page, entry: dict[str, Any], table: Table) -> Iterator[str]:
    rows, columns = entry["rows"], entry["columns"]
    if len(rows) != len(table.rows):
        yield f"table {entry['head']!r}: {len(table.rows)} rows, but {len(rows)} in figures.toml"
        return
    for chosen, cells in zip(rows, table.rows, strict=True):
        if chosen == "":
            continue
        if len(cells) != len(columns):
            yield f"table {entry['head']!r}: {len(cells)} cells in a row, but {len(columns)} columns in figures.toml"
            return
        known: dict[str, Any] = dict(page.names)
        own = columns
        if isinstance(chosen, list):
            own = chosen
        elif isinstance(chosen, str):
            known["row"] = evaluate(chosen, page.names)
        else:
            known["row"] = select(page.folder, {**entry.get("from", {}), **chosen})
        for cell, column in zip(cells, own, strict=True):
            if column:
                yield from _in_cell(cell, column, known, f"table {entry['head']!r}, row {cells[0]!r}")


def _whole(page: Page, entry: dict[str, Any], table: Table) -> Iterator[str]:
    expected = figure_tables.rows(entry, page.folder, page.names)
    if len(expected) != len(table.rows):
        yield f"table {entry['head']!r}: {len(table.rows)} rows, but {len(expected)} in the CSV"
    for cells, known in zip(table.rows, expected, strict=False):
        if cells != (shown := tuple(plain(cell) for cell in known)):
            yield f"table {entry['head']!r}: the page says {' | '.join(cells)}, the CSV {' | '.join(shown)}"


def _in_cell(cell: str, column: str, known: dict[str, Any], where: str) -> Iterator[str]:
    values = [evaluate(expression.strip(), known) for expression in column.split(";")]
    flat = [one for value in values for one in (value if isinstance(value, list) else [value])]
    there = [value for value in flat if value is not None]
    said = list(numbers(cell))
    if len(said) != len(there):
        yield f"{where}: {cell!r} has {len(said)} numbers, {column!r} has {len(there)}"
        return
    for figure, value in zip(said, there, strict=True):
        yield from _compare(figure.said, value, f"{where}: {column}")


def _measured(cell: str) -> list[Figure]:
    named = [found.span() for found in NAMES.finditer(cell)]
    return [
        figure
        for figure in numbers(cell)
        if not any(start <= figure.start and figure.end <= end for start, end in named)
    ]


# ---- tables that a command wrote ----


def _in_csv(page: Page) -> Iterator[str]:
    """Every number with decimals in the named tables of the page is in one of its CSV files, or is one in per cent."""
    files = page.given["csv"]
    known = sorted(
        value * factor for file in files for value in csv_values(page.folder / file) for factor in (1, -1, 100)
    )
    for head in page.given.get("tables", []):
        found = [table for table in tables(page.text) if table.head.startswith(head)]
        if not found:
            yield f"table {head!r}: the page has none"
        for cell in (cell for table in found for row in table.rows for cell in row):
            for figure in numbers(cell):
                if "." in figure.said and not _is_among(figure.said, known):
                    yield f"table {head!r}: {figure.said} in {cell!r} is in none of {', '.join(files)}"


def _is_among(said: str, values: list[float]) -> bool:
    number = number_of(said)
    place = bisect.bisect_left(values, number)
    return any(agrees(said, value) for value in values[max(0, place - 1) : place + 1])
