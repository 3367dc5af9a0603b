"""Lens errors: units are converted, nothing is fitted, and no view is left out silently."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.lens import DisparityRange, Lens, PhysicalLens
from dofbench.evaluation.metrics.lens_errors import do_nothing_errors, lens_errors

RANGE = DisparityRange(0.1, 0.6)
WIDTH = 500  # K is 10 px at A = 1
GRID = {f"{f}_{a}": Lens(aperture=a, focus=f) for f in (0.2, 0.5, 0.8) for a in (0.25, 0.5, 1.0)}


def depths_of(disparity: float | np.ndarray, names) -> dict[str, np.ndarray]:
    """Depth maps whose normalised disparity is the given one."""
    depth = 1 / (RANGE.q_min + RANGE.extent * np.broadcast_to(disparity, (4, 5)))
    return {name: depth.astype(np.float32) for name in names}


def physical(lenses: dict[str, Lens]) -> dict[str, PhysicalLens]:
    return {name: lens.physical(RANGE, WIDTH) for name, lens in lenses.items()}


def test_the_true_lens_has_no_error() -> None:
    errors = lens_errors(GRID, physical(GRID), RANGE, WIDTH, depths_of(0.7, GRID))
    assert (errors.delta_a, errors.delta_f, errors.delta_r) == pytest.approx((0, 0, 0), abs=FLOAT64_VALUE)
    assert list(errors.per_view) == list(GRID)


def test_do_nothing_on_the_full_grid() -> None:
    """The numbers of the conventions: delta_F 0.20 on focus 0.2, 0.5, 0.8; A over 0.25, 0.5, 1 gives 0.25."""
    errors = do_nothing_errors(GRID, RANGE, WIDTH, depths_of(0.7, GRID))
    assert errors.delta_f == pytest.approx(0.2)
    assert errors.delta_a == pytest.approx(0.25)
    by_hand = np.mean([abs(10 * lens.aperture * abs(0.7 - lens.focus) - 1.0) for lens in GRID.values()])
    assert errors.delta_r == pytest.approx(by_hand, rel=FLOAT32_VALUE)


def test_radii_are_in_each_view_s_own_pixels() -> None:
    """The same lenses and errors by their shares of the width, one image twice as wide: its radii are twice as many."""
    true, guess = {"a": Lens(0.5, 0.2), "b": Lens(0.5, 0.2)}, {"a": Lens(0.8, 0.2), "b": Lens(0.8, 0.2)}
    widths = {"a": WIDTH, "b": 2 * WIDTH}
    estimated = {name: lens.physical(RANGE, widths[name]) for name, lens in guess.items()}
    for errors in (
        lens_errors(true, estimated, RANGE, widths, depths_of(0.7, true)),
        do_nothing_errors({name: Lens(0.8, 0.5) for name in true}, RANGE, widths, depths_of(0.7, true)),
    ):
        small, large = (errors.per_view[name].delta_r for name in true)
        assert small > 0 and large == pytest.approx(2 * small, rel=FLOAT32_VALUE)
        assert errors.delta_r == pytest.approx((small + large) / 2, rel=FLOAT32_VALUE)


def test_radii_are_compared_without_their_sign() -> None:
    """Focus in front of or behind a plane by the same amount blurs it the same."""
    true, guess = {"a": Lens(0.5, 0.6)}, {"a": Lens(0.5, 0.8)}
    errors = lens_errors(true, physical(guess), RANGE, WIDTH, depths_of(0.7, true))
    assert errors.delta_f == pytest.approx(0.2)
    assert errors.delta_r == pytest.approx(0, abs=FLOAT32_VALUE)


@given(
    aperture=st.floats(0, 2),
    focus=st.floats(-1, 2),
    guessed_aperture=st.floats(0, 2),
    guessed_focus=st.floats(-1, 2),
    scale=st.sampled_from([0.5, 2.0]),
)
def test_errors_do_not_depend_on_the_estimates_image_width(
    aperture: float, focus: float, guessed_aperture: float, guessed_focus: float, scale: float
) -> None:
    true, guess = {"a": Lens(aperture, focus)}, Lens(guessed_aperture, guessed_focus)
    depth = depths_of(np.linspace(0, 1, 5), true)
    a, b = (
        lens_errors(true, {"a": guess.physical(RANGE, int(width))}, RANGE, WIDTH, depth)
        for width in (WIDTH, WIDTH * scale)
    )
    assert a.delta_a == pytest.approx(abs(aperture - guessed_aperture), abs=FLOAT64_VALUE)
    assert a.delta_f == pytest.approx(abs(focus - guessed_focus), abs=FLOAT64_VALUE)
    assert a.per_view["a"] == pytest.approx(b.per_view["a"], abs=FLOAT64_VALUE)


def test_radius_error_is_a_mean_over_pixels_not_over_views() -> None:
    true = {"all": Lens(1.0, 0.5), "part": Lens(1.0, 0.5)}
    guess = {"all": Lens(1.0, 0.5), "part": Lens(0.5, 0.5)}
    depths = depths_of(0.7, true)
    depths["part"] = depths["part"].copy()
    depths["part"][1:] = 0  # unknown: five pixels of twenty are left
    errors = lens_errors(true, physical(guess), RANGE, WIDTH, depths)
    assert errors.per_view["part"].delta_r == pytest.approx(1.0, rel=FLOAT32_VALUE)
    assert errors.delta_r == pytest.approx(1.0 * 5 / 25, rel=FLOAT32_VALUE)
    assert errors.delta_a == pytest.approx(0.25)


def test_no_known_depth_is_no_number() -> None:
    true = {"a": Lens(1.0, 0.5)}
    errors = lens_errors(true, physical(true), RANGE, WIDTH, {"a": np.zeros((3, 3), np.float32)})
    assert math.isnan(errors.delta_r) and math.isnan(errors.per_view["a"].delta_r)
    assert errors.delta_a == pytest.approx(0)


def test_nan_comes_through() -> None:
    true = {"a": Lens(1.0, 0.5)}
    depth = depths_of(0.7, true)["a"].copy()
    depth[0, 0] = math.nan
    assert math.isnan(lens_errors(true, physical(true), RANGE, WIDTH, {"a": depth}).delta_r)
    broken = {"a": PhysicalLens(math.nan, math.nan, WIDTH)}
    errors = lens_errors(true, broken, RANGE, WIDTH, depths_of(0.7, true))
    assert all(math.isnan(value) for value in (errors.delta_a, errors.delta_f, errors.delta_r))


def test_missing_views_are_refused() -> None:
    depths = depths_of(0.7, GRID)
    estimates = physical(GRID)
    for broken in ({**estimates, "0.5_1.0": None}, {k: v for k, v in estimates.items() if k != "0.5_1.0"}):
        with pytest.raises(ValueError, match="estimate and a depth for view 0.5_1.0"):
            lens_errors(GRID, broken, RANGE, WIDTH, depths)
    with pytest.raises(ValueError, match="for view 0.2_0.25"):
        lens_errors(GRID, estimates, RANGE, WIDTH, {})
    with pytest.raises(ValueError, match="at least one view"):
        lens_errors({}, {}, RANGE, WIDTH, {})
