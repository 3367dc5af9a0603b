"""Which row is best, by how much, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from dofbench.errors import Status
from dofbench.reporting.collect import Entry
from dofbench.reporting.columns import COLUMNS
from dofbench.reporting.paired import SIGNIFICANT, paired_difference
from dofbench.reporting.summary import Line

HEADLINES = ("psnr", "aif_psnr")  # the first of these that any row has


@dataclass(frozen=True)
class Verdict:
    """best, second: variants by the mean of `column`; second is None without a rival. ahead: by how much, positive.
    sure: what bears it, in words. told_apart: whether a test over seeds says that best is better; None where there was
    nothing to test."""

    column: str
    best: tuple[str, ...]
    second: tuple[str, ...] | None
    ahead: float | None
    sure: str
    told_apart: bool | None


def verdict(lines: dict[tuple[str, ...], Line], entries: Sequence[Entry]) -> Verdict | None:
    """Of one board's variants; None where none has a score."""
    for column in HEADLINES:
        known = {variant: line.cells[column].value for variant, line in lines.items()}
        ranked = sorted(
            ((value, variant) for variant, value in known.items() if value is not None and not math.isnan(value)),
            key=lambda one: (-one[0], one[1]))
        if not ranked:
            continue
        value, best = ranked[0]
        if len(ranked) == 1:
            return Verdict(column, best, None, None, "nothing to compare it with", None)
        other, second = ranked[1]
        sure, told_apart = _sure(column, _of(entries, best), _of(entries, second))
        return Verdict(column, best, second, value - other, sure, told_apart)
    return None


def _of(entries: Sequence[Entry], variant: tuple[str, ...]) -> dict[int, Entry]:
    return {entry.spec.seed: entry for entry in entries if entry.variant == variant and entry.status is Status.OK}


def _sure(column: str, best: dict[int, Entry], second: dict[int, Entry]) -> tuple[str, bool | None]:
    """By seeds that both have, in pairs; by test views where there is only one."""
    seeds = sorted(best.keys() & second.keys())
    if len(seeds) > 1:
        pairs = [(best[seed].scores[column], second[seed].scores[column]) for seed in seeds]
        found = paired_difference(pairs)
        said = f"over {len(seeds)} seeds in pairs: {_signed(column, found.mean, found.spread)}"
        if found.p is None:
            return f"{said}; no test, as the differences have no spread", None
        better = found.p < SIGNIFICANT and found.mean > 0
        p = "p < 0.001" if found.p < 0.001 else f"p = {found.p:.3f}"
        return f"{said}, {p}: {'better' if better else 'not told apart'}", better
    said = "one seed in common: what another seed would change is unknown" if seeds else \
        "no seed in common: what another seed would change is unknown"
    one, other = (next(iter(found.values())) for found in (best, second))
    views = _view_pairs(column, one, other)
    if len(views) > 1:
        found = paired_difference(views)
        ahead = sum(a > b for a, b in views)
        said += (f"; over the {len(views)} test views {_signed(column, found.mean, found.spread)}, "
                 f"ahead on {ahead} of them")
    return said, None


def _view_pairs(column: str, one: Entry, other: Entry) -> list[tuple[float, float]]:
    if one.result is None or other.result is None:
        return []
    theirs = {view.name: view.scores for view in other.result.views}
    return [(view.scores[column], theirs[view.name][column]) for view in one.result.views
            if column in view.scores and column in theirs.get(view.name, {})]


def _signed(column: str, mean: float, spread: float | None) -> str:
    known = COLUMNS[column]
    text = f"{mean:+.{known.digits}f}" + ("" if spread is None else f" ± {known.text(spread)}")
    return f"{text} {known.unit}".rstrip()
