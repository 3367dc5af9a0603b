"""Fits on half of a photograph: right for a known scene, and independent of the half that is scored."""

from __future__ import annotations

import math

import numpy as np
import pytest
from known_scene import CAMERA, TRUE, WIDTH, Known
from tolerances import (
    EVEN_BLUR,
    FITTED_APERTURE,
    FITTED_FOCUS,
    FITTED_SIGMA,
    FLOAT64_VALUE,
    ROUGH_APERTURE,
    TWO_FITS_DB,
)

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.evaluation.scoring.photograph_scores import prediction_scores
from dofbench.evaluation.scoring.photographs.predict import predict
from dofbench.evaluation.scoring.photographs.search import QUICK, THOROUGH, Effort, Frame, lens_grid
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.tone import decode, encode

SMALL = Effort(apertures=5, focuses=4, coarse=12, fine=12, blur=True)
PHOTOGRAPH = Known().render(CAMERA, TRUE).image


def coarse(effort: Effort) -> int:
    """The most renderings at the reduced size for both halves."""
    return (effort.apertures + 1) * (effort.focuses + 1) + 1 + 2 * effort.coarse


def most(effort: Effort) -> int:
    """The most renderings for both halves."""
    return coarse(effort) + 2 * effort.fine


def test_the_lens_of_a_known_scene_is_found() -> None:
    method = Known()
    found = predict(method, CAMERA, PHOTOGRAPH, None, SMALL)
    assert found.refused == "" and len(found.halves) == 2
    for half in found.halves:
        assert half.lens.width == WIDTH
        assert half.lens.aperture == pytest.approx(TRUE.aperture, rel=FITTED_APERTURE)
        assert half.lens.focus_disparity == pytest.approx(TRUE.focus_disparity, abs=FITTED_FOCUS)
    scores = prediction_scores(found, PHOTOGRAPH)
    assert scores["photo_psnr"] > 38 > 32 > scores["photo_blur_psnr"], "by depth, which no single blur has"
    assert scores["photo_ssim"] > 0.98
    # One rendering without a lens, one to ask for a lens, and the search's.
    assert len(method.rendered) <= most(SMALL) + 2


def test_the_half_that_is_scored_is_never_looked_at() -> None:
    found = predict(Known(), CAMERA, PHOTOGRAPH, None, SMALL)
    for half in (0, 1):
        changed = PHOTOGRAPH.copy()
        own = found.tiles.fitted(half)
        changed[~own] = np.random.default_rng(half).random((np.count_nonzero(~own), 3))
        again = predict(Known(), CAMERA, changed, None, SMALL)
        assert again.halves[half].lens == found.halves[half].lens, "to the bit"
        assert again.halves[half].sigma == found.halves[half].sigma
        assert again.halves[half].cost == found.halves[half].cost
        assert again.halves[1 - half].lens != found.halves[1 - half].lens
        assert np.array_equal(again.picture[~own], found.picture[~own]), "predicted by the other half alone"
        assert not np.array_equal(again.picture[own], found.picture[own])


def test_a_search_at_a_reduced_size_is_bounded_and_looks_at_no_other_half() -> None:
    assert coarse(THOROUGH) <= 61 and 2 * THOROUGH.fine <= 20
    assert coarse(QUICK) <= 33 and 2 * QUICK.fine == 2
    large = Camera(385, 83, 400.0, 400.0, 192.0, 41.0, np.eye(4))  # cells of 2 x 2 pixels, and a rest
    lens = PhysicalLens(14.0, 0.35, large.width)
    photograph, method = Known().render(large, lens).image, Known()
    found = predict(method, large, photograph, {"a": lens}, QUICK)
    assert method.rendered.count(385) == 1 + 2 * QUICK.fine
    assert len(method.rendered) <= most(QUICK) + 2
    assert found.halves[0].lens.aperture == pytest.approx(14.0, rel=ROUGH_APERTURE)
    changed = photograph.copy()
    changed[~found.tiles.fitted(0)] = 0.3
    assert predict(Known(), large, changed, {"a": lens}, QUICK).halves[0].lens == found.halves[0].lens


class Slow(Known):
    """Its photographs have a border that its sketches lack; `photographs` counts them."""

    def __init__(self) -> None:
        super().__init__()
        self.photographs: list[PhysicalLens] = []

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        found = super().render(camera, lens)
        if lens is not None:
            self.photographs.append(lens)
            found.image[:, :4] = 0.5
        return found

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        return Rendering(defocus_numpy(sharp.image, sharp.depth, lens)[0], sharp.depth)


@pytest.mark.parametrize("width", [WIDTH, 385])
def test_a_slow_method_is_searched_by_its_sketches_and_scored_by_its_photographs(width: int) -> None:
    camera = CAMERA if width == WIDTH else Camera(width, 83, 400.0, 400.0, 192.0, 41.0, np.eye(4))
    lens = PhysicalLens(TRUE.aperture * width / WIDTH, TRUE.focus_disparity, width)
    photograph, method = Known().render(camera, lens).image, Slow()
    found, quick = (predict(one, camera, photograph, None, SMALL) for one in (method, Known()))
    assert len(method.photographs) == 2, "one for each half"
    for half, other, asked in zip(found.halves, quick.halves, method.photographs, strict=True):
        assert half.lens == asked == other.lens and half.renders[1] == other.renders[1] + 1
        assert half.cost > other.cost
    own, other = (one.picture[:, :4].std(axis=(0, 1)) for one in (found, quick))
    assert own.max() < other.min() / 5, "the border of the photographs, evenly grey"


def test_a_method_without_a_lens_gets_its_best_blur() -> None:
    from scipy.ndimage import gaussian_filter

    method = Known(lens=False)
    sharp = method.render(CAMERA, None).image
    photograph = encode(gaussian_filter(decode(sharp), (1.7, 1.7, 0), mode="nearest"))
    found = predict(method, CAMERA, photograph, None, SMALL)
    assert found.refused == "no lens here" and all(half.lens is None for half in found.halves)
    assert all(half.sigma == pytest.approx(1.7, abs=FITTED_SIGMA) for half in found.halves)
    scores = prediction_scores(found, photograph)
    assert scores["photo_psnr"] > 40 and "photo_blur_psnr" not in scores
    assert all(half.sigma == 0 for half in predict(method, CAMERA, sharp, None, SMALL).halves)


def test_another_exposure_and_white_balance_change_no_score() -> None:
    gains = np.array([0.8, 0.9, 0.7], np.float32)
    plain = prediction_scores(predict(Known(), CAMERA, PHOTOGRAPH, None, SMALL), PHOTOGRAPH)
    dim = encode(decode(PHOTOGRAPH) * gains).astype(np.float32)
    other = prediction_scores(predict(Known(), CAMERA, dim, None, SMALL), dim)
    assert other["photo_psnr"] == pytest.approx(plain["photo_psnr"], abs=TWO_FITS_DB) and other["photo_psnr"] > 38


def test_what_isnt_finite_gives_no_score() -> None:
    found = predict(Known(nan=True), CAMERA, PHOTOGRAPH, None, SMALL)
    assert found.picture is None and found.bad == 1
    assert all(math.isnan(value) for value in prediction_scores(found, PHOTOGRAPH).values())


def test_a_method_without_depth_begins_with_its_learned_lenses_or_has_none() -> None:
    learned = {"a": PhysicalLens(5.0, 0.2, WIDTH), "b": PhysicalLens(9.0, 0.8, WIDTH)}
    found = predict(Known(depth=False), CAMERA, PHOTOGRAPH, learned, SMALL)
    assert found.halves[0].lens.focus_disparity == pytest.approx(TRUE.focus_disparity, abs=2 * FITTED_FOCUS)
    assert "neither depth nor learned" in predict(Known(depth=False), CAMERA, PHOTOGRAPH, None, SMALL).refused


def test_an_image_of_another_size_is_refused() -> None:
    class Small(Known):
        def render(self, camera, lens):
            return Rendering(np.zeros((4, 4, 3), np.float32), np.ones((4, 4), np.float32))

    with pytest.raises(ValueError, match="expected an image of shape"):
        predict(Small(), CAMERA, PHOTOGRAPH, None, SMALL)


def test_a_lens_by_its_signed_circles_and_back() -> None:
    frame = Frame(DisparityRange(0.1, 0.6), 200)
    for lens in (PhysicalLens(9.0, 0.2, 200), PhysicalLens(3.0, -0.4, 200), PhysicalLens(5.0, 2.0, 100)):
        back = frame.lens(frame.ends(lens))
        assert back.signed_radius(0.5, 200) == pytest.approx(lens.signed_radius(0.5, 200), abs=FLOAT64_VALUE)
        mirrored = frame.lens(-frame.ends(lens))
        assert (mirrored.aperture, mirrored.focus_disparity) == pytest.approx((back.aperture, back.focus_disparity))
    even = frame.lens(np.array([0.01, 0.01]))
    assert abs(even.signed_radius(0.35, 200)) == pytest.approx(2.0, rel=EVEN_BLUR)
    grid = lens_grid(frame, PhysicalLens(5.0, 50.0, 100), SMALL)
    assert grid[0].aperture == 0 and {lens.width for lens in grid} == {200}
    assert 10.0 in {lens.aperture for lens in grid} and max(lens.focus_disparity for lens in grid) == pytest.approx(1.1)
