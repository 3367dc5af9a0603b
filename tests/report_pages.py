"""Reading the Markdown pages of reports, for their tests."""

from __future__ import annotations

import csv
import io
import itertools
import re
from pathlib import Path


def table_rows(page: str, heading: str) -> list[dict[str, str]]:
    """The rows of the first table below a heading, by column heading."""
    after = page.split(f"## {heading}\n", 1)[1].splitlines()
    start = next(index for index, line in enumerate(after) if line.startswith("| "))
    lines = list(itertools.takewhile(lambda line: line.startswith("| "), after[start:]))
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def notes(page: str, cell: str) -> str:
    """The footnote that a cell points to."""
    number = re.search(r"\[\^(\d+)\]", cell)[1]
    return re.search(rf"^\[\^{number}\]: (.*)$", page, re.MULTILINE)[1]


def rows(file: Path) -> list[dict[str, str]]:
    """Of a CSV file, by the header's names."""
    return list(csv.DictReader(io.StringIO(file.read_text())))
