"""The best row of a board, its lead over the second, and whether the lead is significant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dofbench.reporting import table_cells
from dofbench.reporting.differences import compare
from dofbench.reporting.summary import Line
from dofbench.reporting.view import Cell
from dofbench.results.collecting import Entry

# Boards are ranked by the first of these columns that a row has
HEADLINES = ("psnr", "aif_psnr", "photo_psnr", "across_psnr")


@dataclass(frozen=True)
class Verdict:
    """The best variant of a board. best, second: variants by the mean of `column`; second is None if there is only one.
    ahead: their difference, positive. sure: a cell of kind sure or unsure if the two were tested view by view, else
    untested."""

    column: str
    best: tuple[str, ...]
    second: tuple[str, ...] | None
    ahead: float | None
    sure: Cell


def verdict(lines: dict[tuple[str, ...], Line], entries: Sequence[Entry]) -> Verdict | None:
    """The verdict on one board's variants; None if none has a score."""
    for column in HEADLINES:
        known = {variant: line.cells[column].value for variant, line in lines.items() if column in line.cells}
        ranked = sorted(
            ((value, variant) for variant, value in known.items() if value is not None and not math.isnan(value)),
            key=lambda one: (-one[0], one[1]),
        )
        if not ranked:
            continue
        value, best = ranked[0]
        if len(ranked) == 1:
            return Verdict(column, best, None, None, Cell("nothing to compare it with", "untested"))
        other, second = ranked[1]
        return Verdict(column, best, second, value - other, _sure(column, _of(entries, best), _of(entries, second)))
    return None


def _of(entries: Sequence[Entry], variant: tuple[str, ...]) -> list[Entry]:
    return [entry for entry in entries if entry.variant == variant]


def _sure(column: str, best: Sequence[Entry], second: Sequence[Entry]) -> Cell:
    """The significance of the lead, by the test of the tables of differences over the test views of both variants."""
    compared = compare([(best, second)], column)
    found = compared.difference
    if found is None:
        return Cell(f"not tested: {compared.reason}", "untested")
    seeds = f"{found.seeds} seeds" if found.seeds > 1 else "one seed: what another would change is unknown"
    shown = table_cells.difference(compared)
    cell = replace(shown, text=f"over {found.pairs} test views, {seeds}; {shown.text}", sort=None)
    if found.p is None:
        return replace(cell, kind="untested", below="no test, as nothing differs")
    if shown.test is not None and shown.test.verdict == "better":
        return replace(cell, kind="sure")
    return replace(cell, kind="unsure", below="not told apart")
