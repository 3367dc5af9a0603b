"""Photographs of another aperture: only the focus is fitted, not the aperture, and the strata don't depend on a
method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_scene import CAMERA, HEIGHT, TRUE, WIDTH, Known
from made_up import cloud
from tolerances import FITTED_FOCUS

from dofbench.core.cameras import Camera
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.scoring.photographs.across import FOCUS_EFFORT, predict_across
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, masked_psnr
from dofbench.evaluation.scoring.photographs.strata import sharpness_ratio, thirds

LEARNED = {
    "a": PhysicalLens(13.0, 0.3, WIDTH),
    "b": PhysicalLens(14.0, 0.7, WIDTH),
    "c": PhysicalLens(31.0, 0.2, 2 * WIDTH),
}  # 15.5 at this width: the median is 14
PHOTOGRAPH = Known().render(CAMERA, TRUE).image  # aperture 7


def test_the_learned_aperture_is_scaled_and_the_focus_found() -> None:
    method = Known()
    found = predict_across(method, CAMERA, PHOTOGRAPH, LEARNED, 0.5)
    for half in found.scaled.halves:
        assert half.lens.aperture == pytest.approx(7.0) and half.lens.width == WIDTH
        assert half.lens.focus_disparity == pytest.approx(TRUE.focus_disparity, abs=FITTED_FOCUS)
    assert all(half.lens.aperture == pytest.approx(14.0) for half in found.unscaled.halves)
    inside = found.scaled.tiles.inside
    scores = [
        masked_psnr(picture, PHOTOGRAPH, inside)
        for picture in (found.scaled.picture, found.unscaled.picture, found.in_focus)
    ]
    assert scores[0] > 38 and scores[0] > max(scores[1:]) + 6
    grid_and_simplex = FOCUS_EFFORT.focuses + 2 * (FOCUS_EFFORT.coarse + FOCUS_EFFORT.fine)
    assert len(method.rendered) <= 2 + 2 * grid_and_simplex


def test_a_lens_learned_upright_is_transferred_by_its_opening() -> None:
    """The same opening and focus on a camera with twice this one's focal length in pixels, at 3/4 of its width."""
    upright = replace(CAMERA, width=WIDTH * 3 // 4, height=WIDTH, fx=2 * CAMERA.fx, fy=2 * CAMERA.fy)
    learned = {"a": PhysicalLens(2 * 14.0, 0.4, upright.width), "b": PhysicalLens(14.0, 0.4, WIDTH)}
    cameras = {"a": upright, "b": CAMERA}
    found = predict_across(Known(), CAMERA, PHOTOGRAPH, learned, 0.5, cameras=cameras)
    assert all(half.lens.aperture == pytest.approx(7.0) for half in found.scaled.halves)


def test_the_half_that_is_scored_is_never_looked_at() -> None:
    found = predict_across(Known(), CAMERA, PHOTOGRAPH, LEARNED, 0.5)
    own = found.scaled.tiles.fitted(0)
    changed = np.where(own[..., None], PHOTOGRAPH, 1 - PHOTOGRAPH)
    again = predict_across(Known(), CAMERA, changed, LEARNED, 0.5)
    assert again.scaled.halves[0].lens == found.scaled.halves[0].lens
    assert np.array_equal(again.scaled.picture[~own], found.scaled.picture[~own])
    assert np.array_equal(again.in_focus[~own], found.in_focus[~own])


def test_without_a_lens_one_blur_is_fitted_and_nothing_is_unscaled() -> None:
    for method, learned, reason in (
        (Known(lens=False), LEARNED, "no lens here"),
        (Known(), None, "no learned aperture"),
    ):
        found = predict_across(method, CAMERA, PHOTOGRAPH, learned, 0.5)
        assert found.unscaled is None and reason in found.scaled.refused
        assert all(half.lens is None and half.sigma > 0 for half in found.scaled.halves)
        assert found.in_focus is not None
    assert predict_across(Known(nan=True), CAMERA, PHOTOGRAPH, LEARNED, 0.5).scaled.bad == 1


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
