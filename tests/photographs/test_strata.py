"""Where photographs of one aperture are more blurred than those of another, by the images alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from known_scene import CAMERA, HEIGHT, WIDTH
from made_up import cloud

from dofbench.core.cameras import Camera
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles
from dofbench.evaluation.scoring.photographs.strata import sharpness_ratio, thirds


def wall(blurred_from: float, camera: Camera) -> np.ndarray:
    """Noise on a wall at z = 1, smooth right of `blurred_from`."""
    from scipy.ndimage import gaussian_filter

    image = np.random.default_rng(0).random((camera.height, camera.width, 3)).astype(np.float32)
    smooth = gaussian_filter(image, (3, 3, 0))
    return np.where((np.arange(camera.width) > blurred_from)[None, :, None], smooth, image)


def test_where_the_training_photographs_are_blurred() -> None:
    random = np.random.default_rng(1)
    plane = random.uniform(-0.45, 0.45, (600, 2))
    points = cloud(np.concatenate([plane, np.ones((600, 1))], axis=1))
    training = [(CAMERA, 0.5 * wall(WIDTH / 2, CAMERA), None)] * 3  # half as bright, which doesn't count
    test = [(CAMERA, wall(WIDTH, CAMERA), None)] * 3
    ratio = sharpness_ratio(points, training, test)
    xy, _ = CAMERA.project(points.xyz)
    known, right = np.isfinite(ratio), xy[:, 0] > WIDTH / 2 + 10
    left = xy[:, 0] < WIDTH / 2 - 10
    assert known.sum() > 400 and (ratio[known & right] < 0.2).all() and (ratio[known & left] > 0.5).all()
    inside = Tiles.of(HEIGHT, WIDTH).inside
    found = thirds(points, ratio, CAMERA, inside)
    assert (found[~inside] == -1).all() and abs((found == 0).sum() - (found == 2).sum()) <= 1
    columns = np.nonzero(found == 0)[1]
    assert (columns > WIDTH / 2 - 12).mean() > 0.95 and (np.nonzero(found == 2)[1] < WIDTH / 2 + 12).mean() > 0.95
    # A point lies in every photograph that it projects into, found there or not.
    elsewhere = replace(points, views=tuple(np.array([5]) for _ in range(600)))
    assert np.array_equal(sharpness_ratio(elsewhere, training, test), ratio, equal_nan=True)
    # With fewer than three photographs of either aperture there is no value.
    assert np.isnan(sharpness_ratio(points, training[:2], test)).all()
    assert thirds(points, np.full(600, np.nan), CAMERA, inside) is None
