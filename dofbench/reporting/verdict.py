"""Which row is best, by how much, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.reporting.differences import compare, difference_text
from dofbench.reporting.differences import verdict as difference_verdict
from dofbench.reporting.summary import Line
from dofbench.results.collecting import Entry
from dofbench.results.columns import COLUMNS

HEADLINES = ("psnr", "aif_psnr", "photo_psnr", "across_psnr")  # the first of these that any row has


@dataclass(frozen=True)
class Verdict:
    """best, second: variants by the mean of `column`; second is None without a rival. ahead: by how much, positive.
    sure: what bears it, in words. told_apart: whether the test over views says that best is better; None where there
    was nothing to test."""

    column: str
    best: tuple[str, ...]
    second: tuple[str, ...] | None
    ahead: float | None
    sure: str
    told_apart: bool | None


def verdict(lines: dict[tuple[str, ...], Line], entries: Sequence[Entry]) -> Verdict | None:
    """Of one board's variants; None where none has a score."""
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
            return Verdict(column, best, None, None, "nothing to compare it with", None)
        other, second = ranked[1]
        sure, told_apart = _sure(column, _of(entries, best), _of(entries, second))
        return Verdict(column, best, second, value - other, sure, told_apart)
    return None


def _of(entries: Sequence[Entry], variant: tuple[str, ...]) -> list[Entry]:
    return [entry for entry in entries if entry.variant == variant]


def _sure(column: str, best: Sequence[Entry], second: Sequence[Entry]) -> tuple[str, bool | None]:
    """By the test that the tables of differences have, over the test views of both."""
    compared = compare([(best, second)], column)
    found, known = compared.difference, COLUMNS[column]
    if found is None:
        return f"not tested: {compared.reason}", None
    seeds = f"{found.seeds} seeds" if found.seeds > 1 else "one seed: what another would change is unknown"
    said = f"over {found.pairs} test views, {seeds}; {difference_text(found, known)}"
    if found.p is None:
        return f"{said}: no test, as nothing differs", None
    better = difference_verdict(found, known) == "better"
    return said if better else f"{said}: not told apart", better
