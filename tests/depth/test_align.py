"""The robust scale and shift: exact if the truth is a scale and shift, even if nearly half of the points are
outliers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import ALIGNED, ALIGNED_AMONG_NOISE, RESIDUAL_OF_NOISE

from dofbench.scenes.depth.align import ENOUGH, fit

COUNT = 120


def made(meaning, scale, shift, seed=0):
    """(output, disparity) of points whose disparity is an exact function of the output."""
    disparity = np.random.default_rng(seed).uniform(0.2, 1.0, COUNT)
    return ((disparity if meaning == "disparity" else 1 / disparity) - shift) / scale, disparity


@given(
    st.sampled_from(["disparity", "depth"]),
    st.floats(1e-3, 1e3),
    st.floats(-5, 5),
    st.integers(0, 99),
    st.floats(0, 0.4),
)
def test_it_is_found_among_outliers(meaning, scale, shift, seed, wrong):
    output, disparity = made(meaning, scale, shift, seed)
    generator = np.random.default_rng(seed + 1)
    bad = generator.random(COUNT) < wrong
    disparity = np.where(bad, generator.uniform(0.05, 4.0, COUNT), disparity)
    found = fit(output, disparity, np.ones(COUNT), meaning, "scale-shift")
    assert found is not None
    assert found.scale == pytest.approx(scale, rel=ALIGNED)
    assert found.shift == pytest.approx(shift, rel=ALIGNED, abs=ALIGNED)
    np.testing.assert_allclose(found.disparity(output, meaning)[~bad], disparity[~bad], rtol=ALIGNED)


@given(st.sampled_from(["disparity", "depth"]), st.floats(1e-3, 1e3), st.integers(0, 99))
def test_scale_alone(meaning, scale, seed):
    output, disparity = made(meaning, scale, 0.0, seed)
    disparity[: COUNT // 3] *= 3
    found = fit(output, disparity, np.ones(COUNT), meaning, "scale")
    assert found is not None and found.shift == 0
    assert found.scale == pytest.approx(scale, rel=ALIGNED)
    assert found.inliers == pytest.approx(1 - COUNT // 3 / COUNT)


def test_noise_is_averaged_and_reported():
    output, disparity = made("disparity", 2.0, 0.5)
    noise = np.random.default_rng(3).normal(0, 0.01, COUNT)
    found = fit(output, disparity + noise, np.ones(COUNT), "disparity", "scale-shift")
    assert found is not None
    assert found.scale == pytest.approx(2.0, rel=ALIGNED_AMONG_NOISE)
    assert found.residual == pytest.approx(np.median(np.abs(noise)), rel=RESIDUAL_OF_NOISE)


def test_a_heavier_point_counts_more():
    output, disparity = made("disparity", 1.0, 0.0)
    two = np.concatenate([disparity, disparity + 0.01])
    light = 1e-3
    weight = np.concatenate([np.ones(COUNT), np.full(COUNT, light)])
    found = fit(np.concatenate([output, output]), two, weight, "disparity", "scale-shift")
    # At most the weighted mean of the two; robust weights keep it nearer to the heavier one.
    assert found is not None and 0 <= found.shift <= 0.01 * light / (1 + light)


@pytest.mark.parametrize(
    ("output", "disparity"),
    [
        (np.arange(ENOUGH - 1.0), np.arange(ENOUGH - 1.0)),  # too few
        (np.arange(50.0), 2 - np.arange(50.0) / 50),  # falls as disparity rises
        (np.ones(50), np.linspace(0.1, 1, 50)),  # constant output
    ],
)
def test_there_may_be_none(output, disparity):
    assert fit(output, disparity, np.ones(len(output)), "disparity", "scale-shift") is None


def test_depth_that_is_not_positive_is_infinitely_near():
    output, disparity = made("depth", 1.0, 0.0)
    found = fit(output, disparity, np.ones(COUNT), "depth", "scale-shift")
    assert found is not None
    assert found.disparity(np.array([[-1.0, 0.5]]), "depth")[0, 0] == np.inf
