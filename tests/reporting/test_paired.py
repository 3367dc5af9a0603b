"""Paired differences against scipy and against the formulae."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from tolerances import FLOAT64_VALUE, P_VALUE

from dofbench.ablation.differences import difference_text
from dofbench.reporting.columns import COLUMNS
from dofbench.reporting.paired import Difference, holm, paired_difference


@pytest.mark.parametrize("count", [2, 3, 12])
def test_the_t_statistic_by_hand(count: int) -> None:
    random = np.random.default_rng(count)
    reference = random.normal(25, 3, count)
    value = reference + random.normal(0.3, 0.2, count)
    found = paired_difference(list(zip(value, reference, strict=True)))
    differences = value - reference
    t = differences.mean() / (differences.std(ddof=1) / math.sqrt(count))
    assert found.pairs == count and found.mean == pytest.approx(differences.mean(), abs=FLOAT64_VALUE)
    assert found.spread == pytest.approx(differences.std(ddof=1), abs=FLOAT64_VALUE)
    assert found.p == pytest.approx(2 * stats.t.sf(abs(t), count - 1), rel=P_VALUE)


def test_what_cannot_be_tested() -> None:
    assert paired_difference([(2.0, 1.0)]) == Difference(1, 1.0, None, None)
    assert paired_difference([(2.0, 2.0), (3.0, 3.0)]) == Difference(2, 0.0, 0.0, None)
    assert paired_difference([(3.0, 2.0), (4.0, 3.0)]) == Difference(2, 1.0, 0.0, None)
    assert math.isnan(paired_difference([(math.nan, 1.0), (2.0, 1.0)]).mean)
    with pytest.raises(ValueError, match="at least one pair"):
        paired_difference([])


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == pytest.approx([0.03, 0.06, None, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0] and holm([None]) == [None] and holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_lies_between_the_plain_and_bonferroni_s(values: list[float]) -> None:
    adjusted = holm(values)
    assert all(p <= a <= min(1, p * len(values)) + FLOAT64_VALUE for p, a in zip(values, adjusted, strict=True))
    order = np.argsort(values, kind="stable")
    assert list(np.array(adjusted)[order]) == sorted(adjusted)


@pytest.mark.parametrize(
    ("column", "mean", "p", "text"),
    [
        ("psnr", 0.314, 0.003, "+0.31 ± 0.05, p = 0.003, **better**"),
        ("psnr", -0.314, 0.0002, "-0.31 ± 0.05, p < 0.001, **worse**"),
        ("psnr", 0.314, 0.05, "+0.31 ± 0.05, p = 0.050"),
        ("delta_a", -0.314, 0.01, "-0.314 ± 0.050, p = 0.010, **better**"),
        ("delta_a", 0.314, 0.01, "+0.314 ± 0.050, p = 0.010, **worse**"),
        ("psnr", 0.004, 0.001, "+0.00 ± 0.05, p = 0.001"),
        ("train_s", 3.0, 0.01, "+3.0 ± 0.1, p = 0.010, more"),
    ],
)
def test_a_verdict_stands_only_where_the_test_bears_it(column: str, mean: float, p: float, text: str) -> None:
    assert difference_text(Difference(4, mean, 0.05 if column != "train_s" else 0.1, p), COLUMNS[column]) == text
