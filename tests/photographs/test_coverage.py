"""Which pixels training views cover: known for a wall and cameras beside it, and stated where it isn't."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from known_scene import CAMERA, HEIGHT, WIDTH
from made_up import cloud

from dofbench.core.cameras import Camera
from dofbench.evaluation.scoring.photographs.coverage import CELL, covered

DEPTH = 2.0
SIDE = np.linspace(-1.3, 1.3, 41)
WALL = cloud(np.stack([*(axis.ravel() for axis in np.meshgrid(SIDE, SIDE)), np.full(41 * 41, DEPTH)], axis=1))


def moved(x: float) -> Camera:
    """The test camera moved to the right, scene units."""
    pose = np.eye(4)
    pose[0, 3] = -x
    return replace(CAMERA, world_to_camera=pose)


def test_what_lies_outside_of_all_frames_is_uncovered() -> None:
    # Moved by x, the wall is shifted by fx x / z pixels: a third of the width.
    shift = WIDTH // 3
    right = moved(shift * DEPTH / CAMERA.fx)
    found = covered(WALL, CAMERA, [(right, None)])
    assert found.shape == (HEIGHT, WIDTH)
    assert not found[:, : shift - CELL].any() and found[:, shift + CELL :].all()
    assert covered(WALL, CAMERA, [(right, None), (moved(-shift * DEPTH / CAMERA.fx), None)]).all()
    assert covered(WALL, CAMERA, [(CAMERA, None)]).all()


def test_masked_pixels_of_a_training_view_cover_nothing() -> None:
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:, WIDTH // 2 :] = False
    found = covered(WALL, CAMERA, [(CAMERA, mask)])
    assert found[:, : WIDTH // 2 - CELL].all() and not found[:, WIDTH // 2 + CELL :].any()


def test_a_camera_that_looks_away_covers_nothing() -> None:
    behind = replace(CAMERA, world_to_camera=np.diag([-1.0, 1.0, -1.0, 1.0]))
    assert not covered(WALL, CAMERA, [(behind, None)]).any()


def test_with_too_few_points_coverage_is_unknown() -> None:
    assert covered(WALL.kept(np.arange(len(WALL)) < 20), CAMERA, [(CAMERA, None)]) is None
