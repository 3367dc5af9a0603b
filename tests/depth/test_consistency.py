"""Consistency between views of two planes, whose occlusion is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import cloud, frontal
from tolerances import CONSISTENCY_BIAS, FLOAT32_SCALAR, FLOAT64_VALUE

from dofbench.core.lens import DisparityRange
from dofbench.scenes.depth.multi_view import Consistency, consistencies, neighbours, views_off

WIDTH, HEIGHT, NEAR, FAR = 120, 90, 2.0, 6.0
RANGE = DisparityRange(1 / FAR, 1 / NEAR)


def camera(x):
    return frontal(WIDTH, HEIGHT, 100.0, (x, 0.0, 0.0))


CAMERAS = [camera(0.15 * index) for index in range(6)]


def planes(x):
    """z (H, W) from a camera at x: a near strip, world x from 0 to 0.8, in front of a far plane."""
    at_near = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / 100 * NEAR + x
    return np.tile(np.where((at_near > 0) & (at_near < 0.8), NEAR, FAR), (HEIGHT, 1)).astype(np.float32)


def found(maps, points=None):
    names = [f"v{index}" for index in range(len(maps))]
    return consistencies(names, CAMERAS[: len(maps)], lambda index: maps[index], points, RANGE)


MAPS = [planes(0.15 * index) for index in range(6)]


def test_exact_depth_agrees_and_what_is_hidden_says_nothing():
    for one in found(MAPS):
        assert one is not None
        assert one.difference < FLOAT64_VALUE and one.coc_px < FLOAT64_VALUE and one.bias == 0
        # The strip's rims fall on the neighbouring pixel's other side: one of 120 columns each.
        assert one.consistent > 0.97 and 0.7 < one.compared < 1
    assert views_off(found(MAPS)) == []


@pytest.mark.parametrize("seed", range(3))
def test_points_on_the_borders_of_pixels_fall_to_one_side_whatever_the_last_bits(seed):
    """From camera to camera everything moves by 7.5 or 2.5 pixels, so every point falls on a border."""
    random = np.random.default_rng(seed)
    moved = [
        replace(one, world_to_camera=one.world_to_camera + 1e-14 * random.uniform(-1, 1, (4, 4))) for one in CAMERAS
    ]
    names = [f"v{index}" for index in range(6)]
    again = consistencies(names, moved, lambda index: MAPS[index], None, RANGE)
    for one, other in zip(found(MAPS), again, strict=True):
        assert (one.compared, one.consistent) == (other.compared, other.consistent)
        assert one.difference == pytest.approx(other.difference, abs=FLOAT64_VALUE)


@pytest.mark.parametrize("factor", [0.8, 1.05, 1.2, 3.0])
def test_a_view_off_by_a_factor(factor):
    maps = list(MAPS)
    maps[2] = maps[2] * np.float32(factor)
    agreement = found(maps)
    assert views_off(agreement) == [2]
    one = agreement[2]
    # Relative to the mean of the two disparities, 1 / factor and 1.
    assert one is not None and one.bias == pytest.approx(2 * (1 / factor - 1) / (1 / factor + 1), abs=CONSISTENCY_BIAS)
    others = [value.difference for index, value in enumerate(agreement) if index != 2 and value is not None]
    assert max(others) < FLOAT64_VALUE


def test_swapped_views():
    maps = list(MAPS)
    maps[0], maps[5] = maps[5], np.flipud(maps[0] * np.linspace(0.9, 1.1, WIDTH, dtype=np.float32))
    assert set(views_off(found(maps))) <= {0, 5} and 5 in views_off(found(maps))


def test_the_difference_in_pixels_of_blur():
    maps = [np.full((HEIGHT, WIDTH), 3.0, np.float32) for _ in CAMERAS]
    maps[1] = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    one = found(maps)[1]
    assert one is not None
    assert one.coc_px == pytest.approx(0.02 * WIDTH * (1 / 3 - 1 / 4) / RANGE.extent, rel=FLOAT32_SCALAR)


def test_views_that_share_nothing_have_none():
    away = [CAMERAS[0], replace(CAMERAS[0], world_to_camera=np.diag([-1.0, 1.0, -1.0, 1.0]))]
    assert consistencies(["a", "b"], away, lambda index: MAPS[0], None, RANGE) == [None, None]
    assert found([MAPS[0]]) == [None]
    assert found([MAPS[0], np.zeros_like(MAPS[1])]) == [None, None]
    assert views_off([None, None]) == []


def test_neighbours_share_points_or_stand_near():
    tracks = tuple(np.array(track) for track in ((0, 5), (0, 5), (0, 1)))
    assert neighbours(CAMERAS, cloud(np.ones((3, 3)), tracks))[0][:3] == [5, 1, 2]
    assert neighbours(CAMERAS, None)[0] == [1, 2, 3, 4]
    assert neighbours(CAMERAS[:1], None) == [[]]


def of(*differences, consistent=()):
    """A consistency for each difference; half of the pixels agree unless `consistent` is given."""
    shares = consistent or (0.5,) * len(differences)
    return [Consistency((), 1.0, share, value, value, value) for value, share in zip(differences, shares, strict=True)]


def test_two_alike_views_swapped_differ_at_their_outlines_alone():
    """The shares are those of the built-in scene and of two of its views swapped."""
    assert views_off(of(0.0003, 0.0003, 0.0127, 0.0124, consistent=(0.986, 0.986, 0.859, 0.878))) == [2, 3]
    assert views_off(of(0.01, 0.01, 0.01, 0.01, consistent=(0.82, 0.83, 0.74, 0.82))) == []
    assert views_off(of(0.0003, 0.0003, 0.0003, consistent=(0.999, 0.998, 0.95))) == []


def test_all_views_poor_is_no_reason_to_flag_one_but_beyond_doubt_is():
    assert views_off(of(0.08, 0.10, 0.09, 0.12)) == []
    assert views_off(of(0.08, 0.10, 0.09, 0.25)) == [3]
    assert views_off(of(0.004, 0.005, 0.004, 0.019)) == []
    assert views_off(of(0.004, 0.005, 0.004, 0.021)) == [3]
    assert views_off(of(0.001, 0.06)) == []  # of two views it can't be known which one is wrong
