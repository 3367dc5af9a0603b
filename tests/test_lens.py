"""The lens model: one meaning in normalised and scene units, and the shapes of the aperture."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens, framed_alike

widths = st.integers(16, 4096)
apertures = st.floats(0.0, 2.0)
focuses = st.floats(-0.5, 1.5)
angles = st.floats(-10.0, 10.0)
shapes = st.builds(
    ApertureShape, blades=st.sampled_from([0, 3, 4, 5, 6, 8, 12]), rotation=angles, curvature=st.floats(0, 1)
)


@st.composite
def ranges(draw) -> DisparityRange:
    """Of scenes in units from millimetres to kilometres."""
    q_min = draw(st.floats(-1.0, 1.0))
    unit = draw(st.sampled_from([1e-3, 1.0, 1e3]))
    return DisparityRange(unit * q_min, unit * (q_min + draw(st.floats(0.01, 3.0))))


@st.composite
def cameras(draw) -> Camera:
    """Upright or not, of any size and angle of view, and with pixels that needn't be square."""
    width, height = draw(widths), draw(widths)
    fx = draw(st.floats(0.3, 10.0)) * width
    return Camera(width, height, fx, fx * draw(st.floats(0.5, 2.0)), width / 2, height / 2, np.eye(4))


# ------------------------------------------------------------------------------------------------ disparity ranges


@given(ranges(), st.floats(-1, 2))
def test_normalising_maps_the_range_to_0_and_1(disparity_range, d):
    disparity = disparity_range.q_min + d * disparity_range.extent
    assert disparity_range.normalise(disparity) == pytest.approx(d, abs=FLOAT64_VALUE)
    assert disparity_range.normalise(disparity_range.q_min) == 0


def test_percentiles_leave_out_what_is_unknown():
    disparity = np.concatenate([np.linspace(1.0, 2.0, 101), [0.0, -3.0, np.nan, np.inf]])
    found = DisparityRange.of_disparity(disparity, 0.0, 100.0)
    assert (found.q_min, found.q_max) == (1.0, 2.0)
    inner = DisparityRange.of_disparity(disparity)
    assert (inner.q_min, inner.q_max) == pytest.approx((1.01, 1.99))


def test_a_plane_has_a_range_around_it():
    found = DisparityRange.of_disparity(np.full((4, 5), 0.5))
    assert found.q_min < 0.5 < found.q_max


@pytest.mark.parametrize("disparity", [np.zeros(3), np.array([np.nan, np.inf, -1.0]), np.zeros(0)])
def test_no_disparity_is_an_error(disparity):
    with pytest.raises(ValueError, match="at least one positive disparity"):
        DisparityRange.of_disparity(disparity)


@pytest.mark.parametrize("ends", [(1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.inf)])
def test_a_range_without_extent_is_an_error(ends):
    with pytest.raises(ValueError, match="q_min < q_max"):
        DisparityRange(*ends)


# ------------------------------------------------------------------------------------------------ one lens, two units


@given(apertures, focuses, ranges(), widths)
def test_round_trip_through_scene_units(aperture, focus, disparity_range, width):
    found = Lens.from_physical(Lens(aperture, focus).physical(disparity_range, width), disparity_range)
    assert found.aperture == pytest.approx(aperture, abs=FLOAT64_VALUE)
    assert found.focus == pytest.approx(focus, abs=FLOAT64_VALUE)


@given(apertures, focuses, ranges(), widths, st.floats(-0.5, 1.5))
def test_both_units_give_the_same_radius(aperture, focus, disparity_range, width, d):
    """s = K (d - F), K = 0.02 W A."""
    lens = Lens(aperture, focus)
    disparity = disparity_range.q_min + d * disparity_range.extent
    assert lens.physical(disparity_range, width).signed_radius(disparity, width) == pytest.approx(
        0.02 * width * aperture * (d - focus), abs=FLOAT64_VALUE * width
    )


@given(apertures, focuses, ranges(), st.integers(1, 8), st.floats(-1, 2))
def test_radius_scales_with_the_image(aperture, focus, disparity_range, times, disparity):
    lens = Lens(aperture, focus).physical(disparity_range, 100)
    assert lens.signed_radius(disparity, 100 * times) == pytest.approx(times * lens.signed_radius(disparity, 100))


@given(st.floats(0.1, 1.0), focuses, ranges(), st.floats(1e-3, 1e3))
def test_the_unit_of_length_does_not_matter(aperture, focus, disparity_range, unit):
    scaled = DisparityRange(disparity_range.q_min / unit, disparity_range.q_max / unit)
    lens, other = (Lens(aperture, focus).physical(r, 504) for r in (disparity_range, scaled))
    disparity = disparity_range.q_max
    assert other.signed_radius(disparity / unit, 504) == pytest.approx(
        lens.signed_radius(disparity, 504), abs=FLOAT64_VALUE
    )


def test_llff_width_has_the_released_codes_ten_pixels():
    assert Lens(1.0, 0.5).radius_per_disparity(504) == pytest.approx(10.08)


def test_focus_depth():
    assert PhysicalLens(5.0, 0.25, 504).focus_depth == 4.0
    assert PhysicalLens(5.0, 0.0, 504).focus_depth == PhysicalLens(5.0, -1.0, 504).focus_depth == math.inf


# ------------------------------------------------------------------------------------------------ aperture shapes


@given(shapes, angles)
def test_a_shape_lies_between_its_inscribed_and_circumscribed_circle(shape, angle):
    inner = math.cos(math.pi / shape.blades) if shape.blades else 1.0
    factor = float(shape.radius_factor(angle))
    assert inner - FLOAT64_VALUE <= factor <= 1 + FLOAT64_VALUE


@given(shapes.filter(lambda shape: shape.blades > 0), angles)
def test_a_polygon_repeats_and_mirrors(shape, angle):
    sector = 2 * math.pi / shape.blades
    factor = shape.radius_factor(angle)
    assert float(shape.radius_factor(angle + sector)) == pytest.approx(float(factor), abs=FLOAT64_VALUE)
    assert float(shape.radius_factor(2 * shape.rotation - angle)) == pytest.approx(float(factor), abs=FLOAT64_VALUE)


@given(shapes.filter(lambda shape: shape.blades > 0))
def test_corners_are_where_rotation_says(shape):
    assert float(shape.radius_factor(shape.rotation)) == pytest.approx(1.0)


@pytest.mark.parametrize("blades", [3, 4, 7])
def test_edges_are_straight(blades):
    """Points of one edge of an uncurved polygon lie on the line through its two corners."""
    shape = ApertureShape(blades, rotation=0.6)
    angles = np.linspace(0.6, 0.6 + 2 * math.pi / blades, 9)
    points = shape.radius_factor(angles)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    edge, along = points[-1] - points[0], points - points[0]
    assert np.abs(edge[0] * along[:, 1] - edge[1] * along[:, 0]).max() < FLOAT64_VALUE


def test_what_counts_as_a_disc():
    assert ApertureShape().is_disc and ApertureShape(6, curvature=1.0).is_disc
    assert not ApertureShape(6).is_disc and not ApertureShape(obstruction=0.1).is_disc
    assert np.array_equal(ApertureShape().radius_factor(np.arange(4.0)), np.ones(4))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"blades": 2}, "blades"),
        ({"blades": -1}, "blades"),
        ({"curvature": 1.1}, "curvature"),
        ({"curvature": math.nan}, "curvature"),
        ({"obstruction": 1.0}, "obstruction"),
        ({"obstruction": -0.1}, "obstruction"),
    ],
)
def test_shapes_that_do_not_exist(options, message):
    with pytest.raises(ValueError, match=message):
        ApertureShape(**options)


# ------------------------------------------------------------------------------------------------ between cameras


@given(cameras(), cameras(), st.floats(1e-3, 1e3), st.floats(0.0, 2.0), st.floats(1e-3, 2.0))
def test_a_lens_keeps_its_opening_from_camera_to_camera(one, other, opening, focus, disparity):
    """Against the thin lens: radius = focal length in pixels x half the opening x |1 / z - 1 / z in focus|."""
    lens = PhysicalLens(one.fx * opening, focus, one.width)
    there = lens.transferred(one, other)
    expected = other.fx * opening * (disparity - focus)
    assert there.width == other.width and there.focus_disparity == focus
    assert there.signed_radius(disparity, other.width) == pytest.approx(expected, rel=FLOAT64_VALUE)
    assert there.half_opening(other) == pytest.approx(opening, rel=FLOAT64_VALUE)
    assert lens.half_opening(one) == pytest.approx(opening, rel=FLOAT64_VALUE)


@given(cameras(), cameras(), st.floats(1e-3, 1e3), st.integers(1, 8))
def test_the_size_at_which_a_lens_was_learned_does_not_matter(one, other, aperture, times):
    small = PhysicalLens(aperture, 0.3, one.width).transferred(one, other)
    large = PhysicalLens(aperture * times, 0.3, one.width * times).transferred(one, other)
    assert large.aperture == pytest.approx(small.aperture, rel=FLOAT64_VALUE)


@given(cameras(), st.floats(1e-3, 1e3))
def test_between_equal_cameras_only_the_width_counts(camera, aperture):
    lens = PhysicalLens(aperture, 0.3, 3 * camera.width)
    assert lens.transferred(camera, camera).aperture == aperture * camera.width / (3 * camera.width)  # bit for bit


def test_portrait_and_landscape_are_not_framed_alike():
    across = Camera(320, 240, 280.0, 280.0, 160.0, 120.0, np.eye(4))
    upright = Camera(240, 320, 280.0, 280.0, 120.0, 160.0, np.eye(4))
    assert framed_alike([across, across.resized(640, 480), replace(across, fx=282.0)])
    assert not framed_alike([across, upright]) and framed_alike([])
