"""The best row of a table, its lead over the second, and whether the lead is significant."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dofbench.evaluation.results.collecting import Entry
from dofbench.reporting import table_cells
from dofbench.reporting.boards import Variant
from dofbench.reporting.differences import compare
from dofbench.reporting.summary import Line
from dofbench.reporting.view import Cell

# What a table can be the best at: refocusing, sharp views, and photographs of an unknown lens or of another aperture.
# Ranked by the first of the columns that a row has.
HEADLINES = (("psnr",), ("aif_psnr",), ("photo_psnr", "across_psnr"))


@dataclass(frozen=True)
class Verdict:
    """The best variant at one thing. best, second: variants by the mean of `column`; second is None if there is only
    one. ahead: their difference, positive. sure: a cell of kind sure or unsure if the two were tested view by view,
    else untested."""

    column: str
    best: Variant
    second: Variant | None
    ahead: float | None
    sure: Cell


def verdicts(lines: Mapping[Variant, Line], boards: Sequence[Mapping[Variant, Sequence[Entry]]]) -> tuple[Verdict, ...]:
    """The verdict on each of `HEADLINES` that a row has a score of. lines: of one board, or the means over several.
    boards: of each board, the runs of its variants."""
    return tuple(found for columns in HEADLINES if (found := _verdict(columns, lines, boards)) is not None)


def _verdict(
    columns: Sequence[str], lines: Mapping[Variant, Line], boards: Sequence[Mapping[Variant, Sequence[Entry]]]
) -> Verdict | None:
    for column in columns:
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
        sure = _sure(column, [(runs.get(best, ()), runs.get(second, ())) for runs in boards])
        return Verdict(column, best, second, value - other, sure)
    return None


def _sure(column: str, sides: Sequence[tuple[Sequence[Entry], Sequence[Entry]]]) -> Cell:
    """The significance of the lead, by the test of the tables of differences over the test views of both variants."""
    compared = compare(sides, column)
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
