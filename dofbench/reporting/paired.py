"""Whether one row is really better than another: paired differences and their test."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

SIGNIFICANT = 0.05


@dataclass(frozen=True)
class Difference:
    """Of paired values, one minus the other. spread: sample standard deviation of the differences. p: of the test,
    None where there is nothing to be tested: fewer than two pairs, or differences that are all the same."""

    pairs: int
    mean: float
    spread: float | None
    p: float | None


def paired_difference(pairs: Sequence[tuple[float, float]]) -> Difference:
    """The two-sided paired t-test (Student 1908) on (value, reference) pairs. Raises ValueError for no pair at all."""
    if not pairs:
        raise ValueError("paired difference: expected at least one pair, found none")
    differences = [value - reference for value, reference in pairs]
    mean = math.fsum(differences) / len(differences)
    if len(pairs) < 2 or not all(map(math.isfinite, differences)):
        return Difference(len(pairs), mean, None, None)
    spread = statistics.stdev(differences)
    if spread == 0:  # mostly counts that happen to be equal: without a spread there is no scale to judge by
        return Difference(len(pairs), mean, 0.0, None)
    from scipy.stats import ttest_rel

    values, references = zip(*pairs, strict=True)
    return Difference(len(pairs), mean, spread, float(ttest_rel(values, references).pvalue))


def holm(values: Sequence[float | None]) -> list[float | None]:
    """p values adjusted for being several (Holm, Scandinavian Journal of Statistics 1979); None stays None."""
    known = sorted((p, index) for index, p in enumerate(values) if p is not None)
    adjusted: list[float | None] = [None] * len(values)
    largest = 0.0
    for rank, (p, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * p))
        adjusted[index] = largest
    return adjusted
