"""Make the pages of reports/ from their templates and CSVs (README.md here says how to write a template).

    python benchmarks/make_pages.py                 # all pages
    python benchmarks/make_pages.py lens gpu        # those of two topics
    python benchmarks/make_pages.py --check         # compare instead of writing; status 1 and a diff where one differs

A topic is a folder benchmarks/TOPIC with jinja2 templates: page.md.j2 becomes reports/TOPIC/README.md, any other
NAME.md.j2 becomes reports/TOPIC/NAME.md. A missing file, row, column or name ends the command with one line, status 2.
"""

from __future__ import annotations

import argparse
import csv
import difflib
import math
import re
import statistics
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError

ROOT = Path(__file__).resolve().parents[1]
SHOWN_NUMBER = re.compile(r"([-+]?\d[\d. ]*(e[-+]\d+)?)?%?")
NUMBER = re.compile(r"-?(\d+\.?\d*|\.\d+)(e[-+]\d+)?|inf")
Cell = float | str
Row = Mapping[str, Cell]


class PageError(Exception):
    """A template asks for a file, row or column that isn't there."""


@cache
def read_rows(file: Path) -> tuple[Row, ...]:
    """All rows of a CSV, numbers as such. Raises PageError where there is no such file."""
    if not file.is_file():
        raise PageError(f"{file.name}: no such file in {file.parent}")

    def cell(text: str) -> Cell:
        return (float(text) if set(text) & set(".ei") else int(text)) if NUMBER.fullmatch(text) else text

    with file.open(encoding="utf-8", newline="") as stream:
        return tuple({name: cell(text) for name, text in row.items()} for row in csv.DictReader(stream))


def where(rows: Sequence[Row], **conditions: Any) -> list[Row]:
    """The rows whose cells equal the conditions, or are among them for a list; none is fine."""
    found = list(rows)
    for name, wanted in conditions.items():
        among = wanted if isinstance(wanted, list | tuple) else [wanted]
        found = [row for row in found if row[name] in among]
    return found


def select(folder: Path, file: str, /, **conditions: Any) -> list[Row]:
    """The rows of a file that fulfil the conditions. Raises PageError where none is left."""
    found = where(read_rows(folder / file), **conditions)
    if not found:
        raise PageError(f"{file}: no row with {conditions}")
    return found


def only_cell(folder: Path, file: str, column: str, /, **conditions: Any) -> Cell:
    """The cell of the one row that fulfils the conditions. Raises PageError where there is none or there are more."""
    found = select(folder, file, **conditions)
    if len(found) > 1:
        raise PageError(f"{file}: {len(found)} rows with {conditions}, one is needed")
    return found[0][column]


def of_column(
    summary: Callable[[list[float]], float], rows: Sequence[Row], column: str, most: float = math.inf
) -> float:
    """A summary of a column's cells; empty ones don't count, larger ones than `most` count as that."""
    cells = [row[column] for row in rows if row[column] != ""]
    if not cells or any(isinstance(cell, str) for cell in cells):
        raise PageError(f"column {column!r}: numbers are needed, found {cells[:3]}")
    return summary([min(float(cell), most) for cell in cells])


def fixed(value: Cell, digits: int = 2, sign: str = "") -> str:
    """A number with so many digits after the point; zero has no sign. Raises PageError for text."""
    if isinstance(value, str):
        raise PageError(f"a number is needed, found {value!r}")
    text = f"{value:{sign}.{digits}f}"
    return text if float(text) else text.lstrip("+-")


def shown(rows: Sequence[Row], column: str, digits: int = 2, spread: bool = False) -> str:
    """The mean of a column as text, ± its standard deviation if asked for; – where it has no cell."""
    filled = [row for row in rows if row[column] != ""]
    if not filled:
        return "–"
    mean = fixed(of_column(statistics.mean, filled, column), digits)
    if not spread or len(filled) < 2:
        return mean
    return f"{mean} ± {fixed(of_column(statistics.stdev, filled, column), digits)}"


def exponent(rows: Sequence[Row], column: str, by: str, least: float = 0.0) -> float | str:
    """The slope of log `column` over log `by`, by least squares, over the rows whose `by` is at least `least`; – where
    a cell isn't above zero."""
    points = [(float(row[by]), float(row[column])) for row in rows if float(row[by]) >= least]
    if len(points) < 2 or min(map(min, points)) <= 0:
        return "–"
    return statistics.linear_regression(*zip(*(map(math.log, point) for point in points), strict=True)).slope


def ranked(rows: Sequence[Row], name: str, column: str) -> list[Cell]:
    """The different cells of one column, by the mean of another, largest first; without those that have none."""
    filled = [row for row in rows if row[column] != ""]
    names = dict.fromkeys(row[name] for row in filled)
    return sorted(names, key=lambda key: -of_column(statistics.mean, where(filled, **{name: key}), column))


def variants(rows: Sequence[Row]) -> list[Row]:
    """The rows of a report; one whose options differ from its preset's is of a method of its own, with these options in
    its name: its preset `short sh_degree=3, code 1a2b` becomes `short`."""
    found = []
    for row in rows:
        cells = dict(row)
        for of in ("", "against_"):
            if f"{of}preset" in row:
                cells[f"{of}preset"], *options = str(row[f"{of}preset"]).partition(", code ")[0].split()
                cells[f"{of}method"] = " ".join([str(row[f"{of}method"]), *options])
        found.append(cells)
    return found


def markdown_table(headings: Sequence[str], cells: Sequence[Sequence[str]]) -> str:
    """A table whose columns of numbers are aligned right."""
    right = [all(SHOWN_NUMBER.fullmatch(row[k]) for row in cells) for k in range(len(headings))]
    lines = [headings, ["---:" if number else "---" for number in right], *cells]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def table(rows: Sequence[Row], columns: Mapping[str, str], digits: Mapping[str, int] | None = None) -> str:
    """A Markdown table of some columns, name to heading; digits: after the point, by column."""
    places = digits or {}

    def shown(name: str, cell: Cell) -> str:
        return fixed(cell, places[name]) if name in places and cell != "" else str(cell)

    return markdown_table(list(columns.values()), [[shown(name, row[name]) for name in columns] for row in rows])


def render(template: Path, root: Path) -> str:
    """The page of a template. Raises PageError with the template's line."""
    loader, folder = FileSystemLoader(template.parent), root / "reports" / template.parent.name
    environment = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    environment.globals |= {"rows": partial(select, folder), "value": partial(only_cell, folder)}
    environment.globals |= {"table": table, "ranked": ranked, "exponent": exponent}
    for summary in (statistics.mean, statistics.median, statistics.stdev):
        environment.globals[summary.__name__] = partial(of_column, summary)
    environment.filters |= {
        "fixed": fixed,
        "where": where,
        "shown": shown,
        "variants": variants,
        "signed": partial(fixed, sign="+"),
        "digits": lambda value, count=3: f"{value:.{count}g}",
        "percent": lambda value, digits=0: f"{fixed(100 * value, digits)} %",
        "thousands": lambda value: f"{value:,.0f}".replace(",", " "),
    }
    try:
        return environment.get_template(template.name).render()
    except (PageError, TemplateError, KeyError, TypeError, ValueError) as error:
        lines = [at.lineno for at in traceback.extract_tb(error.__traceback__) if at.filename.endswith(".j2")]
        problem = f"no column {error}" if isinstance(error, KeyError) else error
        place = f"{template.relative_to(root)}:{lines[-1] if lines else getattr(error, 'lineno', 1)}"
        raise PageError(f"{place}: {problem}") from error


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """Make or compare pages; the exit status."""
    parser = argparse.ArgumentParser(description="Make the pages of reports/ from their templates and CSVs.")
    parser.add_argument("topics", nargs="*", metavar="TOPIC", help="folders of benchmarks/ (default: all)")
    parser.add_argument("--check", action="store_true", help="compare with the pages that are there; write nothing")
    options = parser.parse_args(words)
    templates = sorted((root / "benchmarks").glob("*/*.md.j2"))
    known, differs = {template.parent.name for template in templates}, False
    try:
        if unknown := sorted(set(options.topics) - known):
            raise PageError(f"no topic {', '.join(unknown)}; the topics are {', '.join(sorted(known))}")
        for template in templates:
            topic, name = template.parent.name, template.name.removesuffix(".j2")
            if options.topics and topic not in options.topics:
                continue
            page = root / "reports" / topic / ("README.md" if name == "page.md" else name)
            there, made = page.read_text(encoding="utf-8") if page.is_file() else "", render(template, root)
            if made == there:
                continue
            differs = True
            if options.check:
                files = f"{page.relative_to(root)}", f"{template.relative_to(root)}"
                sys.stdout.writelines(difflib.unified_diff(there.splitlines(True), made.splitlines(True), *files))
            else:
                page.write_text(made, encoding="utf-8")
    except PageError as error:
        print(error, file=sys.stderr)
        return 2
    return int(differs and options.check)


if __name__ == "__main__":
    sys.exit(main())
