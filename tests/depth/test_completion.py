"""Edge-aware completion on images for which the result is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import COMPLETED, COMPLETED_SCALE

from dofbench.scenes.depth.completion import complete
from dofbench.scenes.depth.sightings import Sightings

HEIGHT, WIDTH = 48, 64


def sightings(xy, disparity, weight=None):
    weight = np.ones(len(disparity)) if weight is None else weight
    return Sightings(np.asarray(xy, float), np.asarray(disparity, float), weight, 0)


def scattered(count, seed=0):
    return np.random.default_rng(seed).uniform((0.5, 0.5), (WIDTH - 0.5, HEIGHT - 0.5), (count, 2))


def halves():
    """A dark half and a bright one."""
    image = np.full((HEIGHT, WIDTH, 3), 0.2, np.float32)
    image[:, WIDTH // 2 :] = 0.8
    return image


@given(st.floats(0.01, 100), st.integers(1, 40), st.integers(0, 99))
def test_equal_sightings_give_that_everywhere(value, count, seed):
    image = np.random.default_rng(seed).uniform(0, 1, (24, 32, 3)).astype(np.float32)
    xy = scattered(count, seed) / 2
    surface = complete(image, sightings(xy, np.full(count, value)), value).disparity
    np.testing.assert_allclose(surface, value, rtol=COMPLETED_SCALE)


def test_the_surface_breaks_at_the_edge_of_the_image_not_halfway_between_sightings():
    xy = np.array([[4, 10], [6, 30], [60, 12], [58, 40]])
    surface = complete(halves(), sightings(xy, [1, 1, 2, 2]), 1.0).disparity
    assert np.abs(surface[:, : WIDTH // 2 - 1] - 1).max() < COMPLETED
    assert np.abs(surface[:, WIDTH // 2 + 1 :] - 2).max() < COMPLETED


def test_one_wrong_sighting_among_many_is_doubted():
    xy = scattered(60)
    disparity = np.ones(60)
    disparity[7] = 2.0
    completion = complete(np.full((HEIGHT, WIDTH, 3), 0.5, np.float32), sightings(xy, disparity), 1.0)
    assert completion.trusted[7] < 0.1 < 0.9 < np.delete(completion.trusted, 7).min()
    assert np.abs(np.median(completion.disparity) - 1) < COMPLETED


@given(st.floats(1e-3, 1e3))
def test_units_of_the_scene_do_not_matter(unit):
    xy = scattered(30)
    disparity = 1 + xy[:, 0] / WIDTH
    one = complete(halves(), sightings(xy, disparity), 1.0).disparity
    other = complete(halves(), sightings(xy, unit * disparity), unit).disparity
    np.testing.assert_allclose(other, unit * one, rtol=COMPLETED_SCALE)


def test_order_of_the_sightings_does_not_matter():
    xy, order = scattered(30), np.random.default_rng(1).permutation(30)
    disparity = 1 + xy[:, 1] / HEIGHT
    one = complete(halves(), sightings(xy, disparity), 1.0).disparity
    other = complete(halves(), sightings(xy[order], disparity[order]), 1.0).disparity
    np.testing.assert_allclose(other, one, rtol=COMPLETED_SCALE)


def test_a_large_image_goes_through_several_scales():
    image = np.repeat(np.repeat(halves(), 10, axis=0), 10, axis=1)
    xy = np.concatenate([scattered(80) * 10, [[315, 200], [325, 200]]])
    disparity = np.where(xy[:, 0] < 320, 1.0, 2.0)
    surface = complete(image, sightings(xy, disparity), 1.0).disparity
    assert surface.shape == image.shape[:2]
    assert np.abs(surface[:, :310] - 1).max() < COMPLETED and np.abs(surface[:, 330:] - 2).max() < COMPLETED


@pytest.mark.parametrize("xy", [[[0.0, 0.0]], [[WIDTH - 1e-9, HEIGHT - 1e-9]], [[0.5, HEIGHT - 0.5]]])
def test_a_sighting_at_the_rim(xy):
    surface = complete(halves(), sightings(xy, [3.0]), 1.0).disparity
    np.testing.assert_allclose(surface, 3.0, rtol=COMPLETED_SCALE)
