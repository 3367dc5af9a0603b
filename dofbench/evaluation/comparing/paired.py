"""Paired differences between runs: which values are paired, their confidence interval, test and verdict.

Scores of two methods are correlated over test views, so they are compared view by view. Views are few and the
distribution of their errors is unknown: the mean difference is tested by a permutation test that flips the signs of the
per-view differences (Fisher, The Design of Experiments, 1935, section 21). It is exact for any number of views n, but
p is never below 2 ^ (1 - n).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS, COST
from dofbench.evaluation.results.protocol import LENS_COLUMNS, arithmetic_mean

SIGNIFICANT = 0.05
FEWEST = 6  # fewest pairs for which p can be below `SIGNIFICANT`: 2 ** (1 - 6) = 0.031
CONFIDENCE = 0.95  # confidence level of the interval
_EXACT = 16  # largest number of pairs for which all choices of signs are tested: 65536
_FLIPS, _TIMES = 10_000, 10  # random choices of signs for more pairs, in batches
_RESAMPLES = 5_000  # samples of the bootstrap
_SEED = 0  # fixed, so that the same results give the same report
_TIE = 1e-12  # relative difference up to which sums taken in different order count as equal

EXPLANATION = (
    "A difference is the mean over the same views of both methods, seeds averaged first. In brackets: its 95 % "
    "confidence interval by the bootstrap over views and, where there are several, seeds; none below six views, where "
    "it would be too narrow. p: two-sided permutation test that flips the signs of the per-view differences, exact for "
    "few views; with n views p ≥ 2^(1−n), so fewer than six views can't be significant. p is adjusted for the "
    "comparisons of a column (Holm). *Better* and *worse* (for a cost: *more* and *less*) are given only where "
    'p < 0.05 and the interval excludes zero. "One seed" warns that another training could change the result. '
    "Views of a scene are correlated and scenes are not a random sample: p applies to these views, not to other scenes."
)

Group = tuple[np.ndarray, np.ndarray]
Side = Sequence[Entry]  # the seeds of one variant on one dataset


@dataclass(frozen=True)
class Difference:
    """Statistics of paired differences.

    mean: over groups of the mean over each group's pairs. spread: sample standard deviation, None for a single pair.
    p: of the sign-flip test, None if all differences are zero or one isn't finite. low, high: ends of the interval,
    None below `FEWEST` pairs. seeds: trainings on the side that has fewer.
    """

    pairs: int
    mean: float
    spread: float | None
    p: float | None
    low: float | None = None
    high: float | None = None
    seeds: int = 1

    @property
    def telling(self) -> bool:
        """Whether test and interval both justify a verdict."""
        if self.p is None or self.low is None or self.high is None:
            return False
        return self.p < SIGNIFICANT and not self.low <= 0 <= self.high


@dataclass(frozen=True)
class Compared:
    """Comparison of two sides in one column. difference: None if it can't be computed, for the `reason`."""

    column: str
    difference: Difference | None
    reason: str = ""

    @property
    def verdict(self) -> str:
        """better or worse (for a cost, more or less), "" if the difference isn't significant."""
        if self.difference is None or not self.difference.telling:
            return ""
        up, known = self.difference.mean > 0, COLUMNS[self.column]
        if known.higher_is_better is None:
            return "more" if up else "less"
        return "better" if up is known.higher_is_better else "worse"


def compare(groups: Sequence[tuple[Side, Side]], column: str) -> Compared:
    """Compare two sides in a column, paired by view; for a cost, which has no views, by seed.

    groups: both sides' seeds on each dataset. No difference unless every run ended well and has the score for the same
    views.
    """
    pairs: list[Group] = []
    for one, other in groups:
        found = _by_seed(one, other, column) if column in COST else _by_view(one, other, column)
        if isinstance(found, str):
            return Compared(column, None, found)
        pairs.append(found)
    difference = grouped_difference(pairs)
    if column in COST:
        difference = replace(difference, seeds=min(len(one) for one, _ in groups))
    return Compared(column, difference)


def adjusted(compared: Sequence[Compared]) -> list[Compared]:
    """The comparisons with p adjusted for their number."""
    p = holm([one.difference.p if one.difference else None for one in compared])
    return [
        one if one.difference is None else replace(one, difference=replace(one.difference, p=value))
        for one, value in zip(compared, p, strict=True)
    ]


def grouped_difference(groups: Sequence[Group]) -> Difference:
    """Compare paired values; every group (the views of a scene) has the same weight in the mean.

    groups: (values, reference), (S, n) and (T, n) arrays of S and T trainings on the same n units. Raises ValueError
    without any pair, or if the two sides have different units.
    """
    for values, reference in groups:
        if values.ndim != 2 or reference.ndim != 2 or values.shape[1] != reference.shape[1]:
            raise ValueError(f"paired difference: expected (S, n) and (T, n), found {values.shape}, {reference.shape}")
    groups = [group for group in groups if group[0].size and group[1].size]
    if not groups:
        raise ValueError("paired difference: expected at least one pair, found none")
    count = sum(values.shape[1] for values, _ in groups)
    seeds = min(min(len(values), len(reference)) for values, reference in groups)
    with np.errstate(invalid="ignore"):  # the difference of two infinities is NaN, and is shown as NaN
        differences = [values.mean(axis=0) - reference.mean(axis=0) for values, reference in groups]
    mean = arithmetic_mean([arithmetic_mean(one.tolist()) for one in differences])
    # With these weights the plain mean over all pairs is the mean over groups.
    weighted = np.concatenate([one * (count / (len(groups) * len(one))) for one in differences])
    if not np.isfinite(weighted).all():
        return Difference(count, mean, None, None, seeds=seeds)
    spread = float(np.concatenate(differences).std(ddof=1)) if count > 1 else None
    if not np.any(weighted):
        return Difference(count, mean, spread, None, seeds=seeds)
    low, high = _interval(groups) if count >= FEWEST else (None, None)
    return Difference(count, mean, spread, sign_flip(weighted), low, high, seeds)


def sign_flip(differences: np.ndarray) -> float:
    """Two-sided p of the mean of (n,) differences being zero: the share of sign choices whose sum is at least as far
    from zero. All choices are tested up to 16 differences, else many random ones together with the observed one."""
    found = abs(math.fsum(differences)) * (1 - _TIE)
    if len(differences) <= _EXACT:
        sums = np.zeros(1)
        for one in differences:
            sums = np.concatenate([sums + one, sums - one])
        return float(np.mean(np.abs(sums) >= found))
    random = np.random.default_rng(_SEED)
    as_far = 0
    for _ in range(_TIMES):
        signs = random.integers(0, 2, (_FLIPS, len(differences)), dtype=np.int8) * 2.0 - 1.0
        as_far += int(np.count_nonzero(np.abs(signs @ differences) >= found))
    return (1 + as_far) / (1 + _FLIPS * _TIMES)


def holm(values: Sequence[float | None]) -> list[float | None]:
    """p values adjusted for multiple comparisons (Holm, Scandinavian Journal of Statistics 1979); None stays None."""
    known = sorted((p, index) for index, p in enumerate(values) if p is not None)
    adjusted: list[float | None] = [None] * len(values)
    largest = 0.0
    for rank, (p, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * p))
        adjusted[index] = largest
    return adjusted


def _interval(groups: Sequence[Group]) -> tuple[float, float]:
    """Percentile bootstrap interval (Efron 1979): units are resampled within their group, seeds on each side
    independently."""
    random = np.random.default_rng(_SEED)
    means = np.zeros(_RESAMPLES)
    for values, reference in groups:
        units = random.integers(0, values.shape[1], (_RESAMPLES, values.shape[1]))
        for side, sign in ((values, 1.0), (reference, -1.0)):
            # Mean over the resampled seeds of every unit, then over the resampled units.
            seeds = random.integers(0, len(side), (_RESAMPLES, len(side)))
            shares = np.stack([np.mean(seeds == seed, axis=1) for seed in range(len(side))], axis=1)
            means += sign * np.take_along_axis(shares @ side, units, axis=1).mean(axis=1) / len(groups)
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def _by_view(one: Side, other: Side, column: str) -> Group | str:
    sides = [[_values(entry, column) for entry in entries] for entries in (one, other)]
    if not all(rows and all(rows) for rows in sides):
        return "a run of the pair failed, or lacks this score"
    names = [sorted(row) for rows in sides for row in rows]
    if any(name != names[0] for name in names):
        return "the two have no scores of the same views"
    first, second = (np.array([[row[name] for name in names[0]] for row in rows]) for rows in sides)
    return first, second


def _by_seed(one: Side, other: Side, column: str) -> Group | str:
    found = []
    for entries in (one, other):
        if any(entry.status is not Status.OK or column not in entry.scores for entry in entries):
            return "a run of the pair failed, or lacks this score"
        found.append({entry.spec.seed: entry.scores[column] for entry in entries})
    if found[0].keys() != found[1].keys() or not found[0]:
        return "the two were not run with the same seeds"
    first, second = (np.array([[values[seed] for seed in sorted(values)]]) for values in found)
    return first, second


def _values(entry: Entry, column: str) -> dict[str, float]:
    """View -> value of a run; empty unless it has a value for every view."""
    if entry.status is not Status.OK or entry.result is None or column not in COLUMNS:
        return {}
    if column in LENS_COLUMNS:
        return {view.name: getattr(view, column) for view in entry.result.lens}
    views = entry.views
    if any(column not in scores for scores in views.values()):
        return {}
    return {name: scores[column] for name, scores in views.items()}
