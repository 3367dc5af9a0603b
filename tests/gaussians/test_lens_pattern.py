"""Points of the lens and the blur of their cells: together they blur as a disc does, by its transfer function."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import j1
from tolerances import FLOAT32_SCALAR, FLOAT64_VALUE, PATTERN_SCALE

from dofbench.training.gaussians.lens_pattern import (
    MOST_RINGS,
    cell_variance,
    lens_points,
    points_of,
    rings_for,
)

DIRECTIONS = np.linspace(0, np.pi, 24, endpoint=False)
FREQUENCIES = np.geomspace(0.02, np.pi, 200)  # radians a pixel, up to the finest that pixels hold


def mismatch(rings: int, radius: float, drawn: float) -> float:
    """Energy of the difference between a disc of `radius` and the pattern drawn for the radius `drawn`, pixels, on a
    photograph whose amplitudes fall as 1 / frequency."""
    cell = float(cell_variance(torch.tensor([drawn], dtype=torch.float64), rings))
    points = drawn * lens_points(rings)
    waves = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)], axis=1) @ points.T
    phases = np.exp(-1j * FREQUENCIES[:, None, None] * waves).mean(axis=2)
    pattern = phases * np.exp(-(FREQUENCIES**2) * cell / 2)[:, None]
    disc = 2 * j1(FREQUENCIES * radius) / (FREQUENCIES * radius)
    return np.trapezoid((np.abs(pattern - disc[:, None]) ** 2).mean(axis=1) / FREQUENCIES, FREQUENCIES)


@pytest.mark.parametrize("rings", range(MOST_RINGS + 1))
@pytest.mark.parametrize("radius", [1.0, 2.0, 4.0, 8.0])
def test_the_best_scale_of_a_pattern_is_the_discs(rings, radius):
    """So that an aperture that is learned through the pattern isn't biased."""
    scales = np.linspace(0.9, 1.1, 41)
    errors = [mismatch(rings, radius, scale * radius) for scale in scales]
    assert scales[int(np.argmin(errors))] == pytest.approx(1, abs=PATTERN_SCALE)


def test_more_points_are_nearer_to_the_disc():
    for radius in (2.0, 4.0, 8.0):
        errors = [mismatch(rings, radius, radius) for rings in range(MOST_RINGS + 1)]
        assert errors == sorted(errors, reverse=True) and errors[1] < errors[0] / 3


@given(rings=st.integers(2, 6), rotation=st.floats(-10, 10))
def test_many_points_and_their_cells_have_the_discs_variance(rings, rotation):
    pattern = lens_points(rings, rotation)
    cell = float(cell_variance(torch.ones(1, dtype=torch.float64), rings))
    covariance = pattern.T @ pattern / len(pattern) + cell * np.eye(2)
    assert covariance == pytest.approx(0.25 * np.eye(2), abs=FLOAT64_VALUE)


@given(rings=st.integers(0, 6), rotation=st.floats(-10, 10))
def test_points_lie_evenly_on_the_lens(rings, rotation):
    pattern = lens_points(rings, rotation)
    assert len(pattern) == points_of(rings) == [1, 5, 19, 37, 61, 91, 127][rings]
    assert np.hypot(*pattern.T).max(initial=0) < 1
    assert pattern.mean(axis=0) == pytest.approx(0, abs=FLOAT64_VALUE)
    turned = lens_points(rings) @ [[np.cos(rotation), np.sin(rotation)], [-np.sin(rotation), np.cos(rotation)]]
    assert pattern == pytest.approx(turned, abs=FLOAT64_VALUE)


def test_a_small_circle_has_the_discs_variance_and_a_wide_one_more():
    small, wide = (float(cell_variance(torch.tensor([r], dtype=torch.float64), 0)) / r**2 for r in (1e-3, 1e3))
    assert small == pytest.approx(0.25, rel=FLOAT32_SCALAR) and wide > 0.31


@pytest.mark.parametrize(
    ("radius", "points"), [(0.0, 1), (0.9, 1), (1.1, 5), (3.4, 5), (3.6, 19), (6.4, 19), (6.7, 37), (50.0, 37)]
)
def test_wider_circles_need_more_points(radius, points):
    circles = torch.zeros(200)
    circles[50:] = radius
    assert points_of(rings_for(circles)) == points
    assert rings_for(circles, 5) >= rings_for(circles) and rings_for(circles, 1) <= 1
    assert rings_for(circles[:0]) == rings_for(circles * torch.nan) == 0  # nothing in view


def test_a_hundredth_of_the_circles_may_be_wider():
    """Of those that are in view."""
    circles = torch.full((400,), torch.nan)
    circles[:200] = 0.5
    circles[:2] = 50.0
    assert rings_for(circles) == 0
    circles[2] = 50.0
    assert rings_for(circles) == MOST_RINGS


def test_between_small_and_wide_the_variance_goes_with_the_cube_of_the_radius():
    """So that it is settled within two pixels: eight times nearer to the wide one's at twice the radius."""
    radius = torch.tensor([1e-3, 0.7, 1.4, 1e3], dtype=torch.float64)
    small, one, two, wide = (cell_variance(radius, 0) / radius.square()).tolist()
    nearer = [(share - small) / (wide - share) for share in (one, two)]
    assert nearer[1] / nearer[0] == pytest.approx(8, rel=FLOAT32_SCALAR)
