"""Learned foci against EXIF's distances: against scipy's correlation and numpy's line, and what can't be compared."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr
from tolerances import FLOAT64_VALUE

from dofbench.evaluation.metrics.exif_errors import exif_focus_errors

DISTANCES = [0.5, 0.7, 0.9, 1.3, 2.0, 4.0, math.inf]


def test_a_scale_and_an_offset_are_no_error() -> None:
    found = exif_focus_errors([(3.7 / distance + 0.2, distance) for distance in DISTANCES])
    assert found.rank == pytest.approx(1, abs=FLOAT64_VALUE) and found.scatter == pytest.approx(0, abs=FLOAT64_VALUE)
    assert found.reason == found.no_scatter == ""


@given(
    st.lists(
        st.tuples(st.floats(0.05, 10), st.sampled_from([0.4, 0.5, 0.8, 1.25, 3.0, 7.0, math.inf])),
        min_size=5,
        max_size=30,
    ).filter(lambda drawn: len({d for _, d in drawn}) > 2 and np.ptp([q for q, _ in drawn]) > 1)
)
def test_against_scipy_and_numpy(drawn: list[tuple[float, float]]) -> None:
    found = exif_focus_errors(drawn)
    learned, written = np.array([q for q, _ in drawn]), np.array([1 / d for _, d in drawn])
    assert found.rank == pytest.approx(spearmanr(learned, written).statistic, abs=FLOAT64_VALUE)
    line = np.stack([written, np.ones_like(written)], 1)
    (scale, _), *_ = np.linalg.lstsq(line, learned, rcond=None)
    if scale < 0:
        line = line[:, 1:]
    fit, *_ = np.linalg.lstsq(line, learned, rcond=None)
    expected = 100 * math.sqrt(np.square(learned - line @ fit).sum() / (len(drawn) - 2)) / learned.mean()
    assert found.scatter == pytest.approx(expected, rel=FLOAT64_VALUE, abs=FLOAT64_VALUE)


@given(st.floats(0.01, 100), st.floats(0.1, 10))
def test_neither_unit_counts(scene: float, metre: float) -> None:
    noise = np.random.default_rng(0).normal(1, 0.1, len(DISTANCES))
    estimates = [(error * (1 / distance + 0.1), distance) for error, distance in zip(noise, DISTANCES, strict=True)]
    one, other = exif_focus_errors(estimates), exif_focus_errors([(scene * q, metre * d) for q, d in estimates])
    assert other.rank == pytest.approx(one.rank, abs=FLOAT64_VALUE)
    assert other.scatter == pytest.approx(one.scatter, rel=FLOAT64_VALUE)


def test_a_tenth_of_noise_is_a_scatter_of_a_tenth_or_so() -> None:
    distances = np.linspace(1, 1.2, 200)
    noise = np.random.default_rng(1).normal(1, 0.1, 200)
    found = exif_focus_errors([(error / distance, distance) for error, distance in zip(noise, distances, strict=True)])
    assert 8 < found.scatter < 12


def test_infinity_is_farther_than_anything_and_beyond_it_is_farther_still() -> None:
    learned = [1.0, 0.8, 0.3, 0.01, -0.02]
    assert exif_focus_errors(list(zip(learned, [1, 2, 3, 50, math.inf], strict=True))).rank == pytest.approx(1)
    assert exif_focus_errors(list(zip(learned, [math.inf, 50, 3, 2, 1], strict=True))).rank == pytest.approx(-1)


def test_a_scale_is_never_negative() -> None:
    """Foci in reverse: the best scale is none, and the scatter is that of the foci themselves."""
    learned = np.array([0.1, 0.3, 0.5, 0.8, 1.0, 1.2])
    found = exif_focus_errors(list(zip(learned, [0.5, 0.6, 0.7, 1, 2, 3], strict=True)))
    expected = 100 * math.sqrt(np.square(learned - learned.mean()).sum() / 4) / learned.mean()
    assert found.rank == pytest.approx(-1) and found.scatter == pytest.approx(expected, rel=FLOAT64_VALUE)


@pytest.mark.parametrize(
    ("estimates", "why"),
    [
        ([], "no training view"),
        ([(1.0 / d, d) for d in DISTANCES[:4]], "fewer than 5"),
        ([(1.0 + i / 10, (1.0, 2.0)[i % 2]) for i in range(8)], "fewer than 3 different"),
        ([(0.5 + 1e-9 * i, d) for i, d in enumerate(DISTANCES)], "one learned focus"),
        ([(0.0, d) for d in DISTANCES], "one learned focus"),
        ([(math.nan, d) for d in DISTANCES], "finite"),
        ([(math.inf, 1.0), *((1.0 / d, d) for d in DISTANCES)], "finite"),
    ],
)
def test_what_cant_be_compared_has_a_reason(estimates: list[tuple[float, float]], why: str) -> None:
    found = exif_focus_errors(estimates)
    assert found.rank is None and found.scatter is None and why in found.reason and why in found.no_scatter


def test_foci_beyond_infinity_on_average_have_ranks_alone() -> None:
    found = exif_focus_errors([(1 / distance - 9, distance) for distance in DISTANCES])
    assert found.rank == pytest.approx(1) and found.scatter is None and "beyond infinity" in found.no_scatter
