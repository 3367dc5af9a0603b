"""Tables of a page that figures.toml describes whole, a row for each value of a CSV's column: what their rows are, and
the page with those rows written into it.

    [[page.table]]
    head = "| method | attic |"          # how the table's first line begins; the page has it, and the rule below
    each = "method"                      # a row for each value of this column among the rows of `from`
    from = { csv = "board.csv", by = "dataset" }
    columns = ["attic.psnr", "mean(known[name].psnr)"]  # of a row, behind its name; `name` is the row's
    digits = [2, 2]                      # decimals of each
    order = "attic.psnr"                 # the largest first; a row without this value is left out
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from figure_values import Rows, evaluate, select

ABSENT = "–"


def rows(entry: Mapping[str, Any], folder: Path, names: Mapping[str, Rows]) -> list[tuple[str, ...]]:
    """The cells of the rows of a table, as a page has them. Raises NoSuchValue for what can't be computed."""
    column, among = entry["each"], entry["from"]
    placed = []
    for name in dict.fromkeys(select(folder, {**among, "by": column}).names()):
        known = {**names, "name": name, "row": select(folder, {**among, column: name})}
        place = evaluate(entry["order"], known)
        if place is not None:
            values = [evaluate(expression, known) for expression in entry["columns"]]
            cells = (number(value, digits) for value, digits in zip(values, entry["digits"], strict=True))
            placed.append((-place, name, (f"`{name}`", *cells)))
    return [cells for _, _, cells in sorted(placed)]


def number(value: float | None, digits: int) -> str:
    """A value with so many decimals, thousands set apart by a space; a dash for none."""
    return ABSENT if value is None else f"{value:,.{digits}f}".replace(",", " ").replace("-", "−")


def filled(text: str, tables: list[tuple[str, list[tuple[str, ...]]]]) -> str:
    """A page's text with the rows of some tables, (how its first line begins, rows), in place of those that it has.
    Raises ValueError for a table that the page hasn't."""
    lines = text.splitlines()
    for head, cells in tables:
        start = next((place for place, line in enumerate(lines) if line.startswith(head)), None)
        if start is None:
            raise ValueError(f"the page has no table {head!r}")
        end = start + 2
        while end < len(lines) and lines[end].startswith("|"):
            end += 1
        lines[start + 2 : end] = [f"| {' | '.join(row)} |" for row in cells]
    return "\n".join(lines) + "\n"
