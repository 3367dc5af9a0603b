"""Depth errors: the unit of focus, unknown pixels left out, empty pixels counted."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.lens import DisparityRange, Lens
from dofbench.evaluation.metrics.depth_errors import disparity_error, relative_error

RANGE = DisparityRange(0.1, 0.6)
TRUTH = np.random.default_rng(0).uniform(2, 9, (6, 7))


def test_the_truth_has_no_error() -> None:
    assert disparity_error(TRUTH, TRUTH, RANGE) == relative_error(TRUTH, TRUTH) == 0


@given(st.floats(-0.05, 0.3))
def test_a_constant_shift_of_disparity_is_the_error(shift: float) -> None:
    moved = 1 / (1 / TRUTH + shift * RANGE.extent)
    assert disparity_error(moved, TRUTH, RANGE) == pytest.approx(abs(shift), abs=FLOAT64_VALUE)


@given(st.floats(0.1, 4))
def test_a_factor_on_depth_is_the_relative_error(factor: float) -> None:
    assert relative_error(factor * TRUTH, TRUTH) == pytest.approx(abs(factor - 1), abs=FLOAT64_VALUE)


def test_it_is_how_far_the_circle_of_confusion_is_off() -> None:
    """On one side of the focus, K times the error is the mean difference of the radii."""
    lens, width = Lens(aperture=1.0, focus=-1.0), 500
    physical = lens.physical(RANGE, width)
    moved = TRUTH * np.random.default_rng(1).uniform(0.8, 1.2, TRUTH.shape)
    radii = [physical.signed_radius(1 / depth, width) for depth in (moved, TRUTH)]
    expected = np.abs(radii[0] - radii[1]).mean()
    assert lens.radius_per_disparity(width) * disparity_error(moved, TRUTH, RANGE) == pytest.approx(expected)


def test_unknown_pixels_do_not_count_and_empty_ones_do() -> None:
    truth, depth = np.array([[4.0, 0.0], [5.0, 8.0]]), np.array([[4.0, 7.0], [0.0, 8.0]])
    assert relative_error(depth, truth) == pytest.approx(1 / 3)
    assert disparity_error(depth, truth, RANGE) == pytest.approx((1 / 5) / RANGE.extent / 3)


def test_float32_maps() -> None:
    depth = (TRUTH * 1.1).astype(np.float32)
    assert relative_error(depth, TRUTH.astype(np.float32)) == pytest.approx(0.1, rel=10 * FLOAT32_VALUE)


def test_a_nan_is_seen_and_nothing_known_is_no_error() -> None:
    depth = TRUTH.copy()
    depth[2, 3] = math.nan
    nothing = np.zeros_like(TRUTH)
    assert math.isnan(disparity_error(depth, TRUTH, RANGE)) and math.isnan(relative_error(depth, TRUTH))
    assert math.isnan(disparity_error(TRUTH, nothing, RANGE)) and math.isnan(relative_error(TRUTH, nothing))


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        relative_error(TRUTH[1:], TRUTH)
    with pytest.raises(ValueError, match="shape"):
        disparity_error(TRUTH[1:], TRUTH, RANGE)
