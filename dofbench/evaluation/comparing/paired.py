"""Paired differences between runs: what is paired, by which model they are judged, and when nothing can be decided.

Scores of two methods are correlated over test views, so they are compared view by view. On one scene a view's
difference is a mean plus the scatter of views and of trainings, and what is found holds for views of this scene. Over
scenes, a scene's difference is a mean plus the scatter of scenes: views of one scene aren't independent, so the scenes
are the sample, and what is found holds for scenes like these.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dofbench.core.errors import Status
from dofbench.evaluation.comparing.design import SIGNIFICANT, undecided
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import COLUMNS, COST
from dofbench.evaluation.results.protocol import LENS_COLUMNS, arithmetic_mean

CONFIDENCE = 0.95  # confidence level of the interval
_EXACT = 16  # largest number of pairs for which all choices of signs are tested: 65536
_FLIPS, _TIMES = 10_000, 10  # random choices of signs for more pairs, in batches
_SEED = 0  # fixed, so that the same results give the same report
_TIE = 1e-12  # relative difference up to which sums taken in different order count as equal

EXPLANATION = (
    "A difference is the mean over the same views of both methods; seeds are averaged first, and every scene has the "
    "same weight. In brackets: its 95 % interval by Student's t. Behind it: on how many views the first is the "
    "better. On one scene the model is a mean plus normal scatter of views and, where there are several, of seeds "
    "(Satterthwaite's degrees of freedom); the interval is about views of this scene. Over scenes it is a mean plus "
    "normal scatter of scenes, of which the scenes' means are the sample: the interval is about scenes like these, "
    "and wide where they are few. A pair has one p, in the score that is named with its table: over scenes of the "
    "t-test, on one scene of the permutation test that flips the signs of the views' differences, which needs no "
    "normal scatter; adjusted for the number of pairs (Holm). There is none where the design can't decide: below six "
    "views of one scene, where such a test has p ≥ 2^(1−n) whatever happens, and for two scenes. *Better* and *worse* "
    '(for a cost: *more* and *less*) are given only where p < 0.05 and the interval excludes zero. "One seed" warns '
    "that another training could change the result."
)

Group = tuple[np.ndarray, np.ndarray]
Side = Sequence[Entry]  # the seeds of one variant on one dataset


@dataclass(frozen=True)
class Difference:
    """Statistics of paired differences.

    pairs: views, or seeds of a cost, in all. mean: over groups of the mean over each group's pairs. spread: sample
    standard deviation of the units, which are the pairs of one group or the means of several; None for a single one.
    p: None where the design can't decide (`undecided`), all differences are zero, or one isn't finite. low, high: ends
    of the interval, None for a single unit. seeds: trainings on the side that has fewer. groups: scenes. above, below:
    pairs whose difference is above and below zero.
    """

    pairs: int
    mean: float
    spread: float | None
    p: float | None
    low: float | None = None
    high: float | None = None
    seeds: int = 1
    groups: int = 1
    above: int = 0
    below: int = 0

    @property
    def units(self) -> int:
        """How many differences the interval is estimated from."""
        return self.groups if self.groups > 1 else self.pairs

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


def compare(groups: Sequence[tuple[Side, Side]], column: str, *, test: bool = True) -> Compared:
    """Compare two sides in a column, paired by view; for a cost, which has no views, by seed.

    groups: both sides' seeds on each dataset. test: whether to compute p, which takes most of the time. No difference
    unless every run ended well and has the score for the same views.
    """
    pairs: list[Group] = []
    for one, other in groups:
        found = _by_seed(one, other, column) if column in COST else _by_view(one, other, column)
        if isinstance(found, str):
            return Compared(column, None, found)
        pairs.append(found)
    difference = grouped_difference(pairs, test=test)
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


def grouped_difference(groups: Sequence[Group], *, test: bool = True) -> Difference:
    """Compare paired values; every group (the views of a scene) has the same weight in the mean; without p unless
    `test`.

    groups: (values, reference), (S, n) and (T, n) arrays of S and T trainings on the same n units. Raises ValueError
    without any pair, or if the two sides have different units.
    """
    for values, reference in groups:
        if values.ndim != 2 or reference.ndim != 2 or values.shape[1] != reference.shape[1]:
            raise ValueError(f"paired difference: expected (S, n) and (T, n), found {values.shape}, {reference.shape}")
    groups = [group for group in groups if group[0].size and group[1].size]
    if not groups:
        raise ValueError("paired difference: expected at least one pair, found none")
    with np.errstate(invalid="ignore"):  # the difference of two infinities is NaN, and is shown as NaN
        differences = [values.mean(axis=0) - reference.mean(axis=0) for values, reference in groups]
    every = np.concatenate(differences)
    units = differences[0] if len(groups) == 1 else np.array([arithmetic_mean(one.tolist()) for one in differences])
    found = Difference(
        len(every),
        arithmetic_mean(units.tolist()),
        None,
        None,
        seeds=min(min(len(values), len(reference)) for values, reference in groups),
        groups=len(groups),
        above=int(np.count_nonzero(every > 0)),
        below=int(np.count_nonzero(every < 0)),
    )
    if not np.isfinite(units).all() or len(units) == 1:
        return found
    found = replace(found, spread=float(units.std(ddof=1)))
    if not np.any(units):
        return found
    parts = [_Part(float(units.var(ddof=1)) / len(units), len(units) - 1)]
    if len(groups) == 1:  # over scenes, trainings differ from scene to scene, so their scatter is in the scenes'
        parts += [part for side in groups[0] if (part := _Part.of_seeds(side)) is not None]
    low, high, p = _by_t(found.mean, parts)
    found = replace(found, low=low, high=high)
    if not test or undecided(found.pairs, found.groups):
        return found
    return replace(found, p=sign_flip(units) if len(groups) == 1 else p)


@dataclass(frozen=True)
class _Part:
    """A part of the variance of a mean, and its degrees of freedom."""

    variance: float
    freedom: int

    @classmethod
    def of_seeds(cls, side: np.ndarray) -> _Part | None:
        """What the scatter of trainings adds, by their means over the views; None for a single training. side: (S, n)
        scores."""
        count = len(side)
        return None if count < 2 else cls(float(side.mean(axis=1).var(ddof=1)) / count, count - 1)


def _by_t(mean: float, parts: Sequence[_Part]) -> tuple[float, float, float]:
    """(low, high, p) of a mean whose variance is the sum of the parts, by Student's t with the degrees of freedom of
    Satterthwaite, Biometrics Bulletin 1946."""
    from scipy.special import stdtr, stdtrit  # what scipy.stats.t calls, after many checks

    variance = math.fsum(part.variance for part in parts)
    if variance == 0:
        return mean, mean, 0.0
    freedom = 1 / math.fsum((part.variance / variance) ** 2 / part.freedom for part in parts)
    half = float(stdtrit(freedom, (1 + CONFIDENCE) / 2)) * math.sqrt(variance)
    return mean - half, mean + half, float(2 * stdtr(freedom, -abs(mean) / math.sqrt(variance)))


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
