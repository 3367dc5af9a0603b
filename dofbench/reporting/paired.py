"""Statistics of the difference between two runs: paired differences, their confidence interval and their test.

Scores of two methods are correlated over test views, since some views are easy and others hard, so they are compared
view by view. The views are few and the distribution of their errors is unknown, so the mean difference is tested by a
permutation test that flips the signs of the per-view differences (Fisher, The Design of Experiments, 1935, section 21).
It only assumes that, if there is no difference, both signs are equally likely. The test is exact for any number of
views, but can't be significant with too few: with n views p is never below 2 ^ (1 - n).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dofbench.evaluation.results.protocol import arithmetic_mean

SIGNIFICANT = 0.05
FEWEST = 6  # fewest pairs for which p can be below `SIGNIFICANT`: 2 ** (1 - 6) = 0.031
CONFIDENCE = 0.95  # confidence level of the interval
_EXACT = 16  # largest number of pairs for which all choices of signs are tested: 65536
_FLIPS = 10_000  # number of random choices of signs for more pairs
_TIMES = 10
_RESAMPLES = 5_000  # samples of the bootstrap
_SEED = 0  # fixed, so that the same results give the same report
_TIE = 1e-12  # relative difference up to which sums taken in different order count as equal

# The explanation that a page prints with such differences.
EXPLANATION = (
    "A difference is the mean over the same views of both, seeds averaged first. In brackets: its 95 % interval by the "
    "bootstrap, which draws views and, where there are several, seeds anew; below six views it would be too narrow, "
    "and there is none. p is of a two-sided permutation test that flips the signs of the views' differences, exact for "
    "few views: with n of them it is never below 2^(1−n), so fewer than six can't tell. It is adjusted for the "
    "comparisons of a column (Holm). *Better* and *worse* (for a cost: *more* and *less*) stand only where p < 0.05 "
    'and the interval leaves zero out; "one seed" warns that training again could change it. Views of a scene aren\'t '
    "independent of each other, and scenes not drawn at random: p speaks of these views, not of other scenes."
)

Group = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Difference:
    """Statistics of the differences of paired values. mean: mean over groups of the mean over each group's pairs.
    spread: sample standard deviation of the differences, None for a single pair. p: of the sign-flip test, None if all
    differences are zero or one isn't finite. low, high: ends of the bootstrap's interval, None below `FEWEST` pairs.
    seeds: number of trainings on the side that has fewer."""

    pairs: int
    mean: float
    spread: float | None
    p: float | None
    low: float | None = None
    high: float | None = None
    seeds: int = 1

    @property
    def telling(self) -> bool:
        """Whether test and interval both justify a verdict such as better."""
        return (
            self.p is not None
            and self.p < SIGNIFICANT
            and self.low is not None
            and self.high is not None
            and not self.low <= 0 <= self.high
        )


def grouped_difference(groups: Sequence[Group]) -> Difference:
    """Compare paired values, group by group (a scene's views, say). A group is (values, reference): (S, n) and (T, n)
    arrays of S and T trainings on the same n units, in the same order.

    All groups have the same weight in the mean, as in a mean over scenes. Raises ValueError without any pair, or if the
    two sides have different units.
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
    """Two-sided p of the mean of (n,) differences being zero: the share of sign choices for which the sum is at least
    as far from zero. All choices are tested up to 16 differences, else many random ones together with the observed
    one."""
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
