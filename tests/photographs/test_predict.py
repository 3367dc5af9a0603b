"""The fit on half of a photograph: right for a known scene, within its bounds, and blind to the half that is scored."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from known_scene import CAMERA, TRUE, WIDTH, Known
from tolerances import FITTED_FOCUS, TWO_FITS_DB

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.image_files.exif import Exif
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.scoring.photograph_scores import prediction_scores
from dofbench.evaluation.scoring.photographs.image_tiles import masked_psnr
from dofbench.evaluation.scoring.photographs.learned_aperture import learned_aperture
from dofbench.evaluation.scoring.photographs.predict import predict
from dofbench.evaluation.scoring.photographs.search import QUICK, THOROUGH
from dofbench.optics.defocus import defocus_numpy
from dofbench.optics.tone import decode, encode

PHOTOGRAPH = Known().render(CAMERA, TRUE).image


def test_the_lens_of_a_known_scene_is_found() -> None:
    method = Known()
    found = predict(method, CAMERA, PHOTOGRAPH, TRUE.aperture, THOROUGH)
    assert found.refused == "" and found.fit.lens.width == WIDTH and not found.fit.at_bound
    assert found.fit.lens.aperture == TRUE.aperture
    assert found.fit.lens.focus_disparity == pytest.approx(TRUE.focus_disparity, abs=FITTED_FOCUS)
    scores = prediction_scores(found, PHOTOGRAPH)
    assert scores["photo_psnr"] > 38 > 32 > scores["photo_sharp_psnr"]
    assert scores["photo_ssim"] > max(0.99, scores["photo_sharp_ssim"])
    # One rendering without a lens, one to ask for a lens, and the search's.
    assert len(method.rendered) <= 3 + THOROUGH.focuses + THOROUGH.coarse + THOROUGH.fine


def test_a_focus_outside_of_the_bounds_is_marked() -> None:
    far = PhysicalLens(3.0, -0.3, WIDTH)  # disparities are 0.2 to 0.8, foci 0.05 to 0.95
    found = predict(Known(), CAMERA, Known().render(CAMERA, far).image, 3.0, THOROUGH)
    assert found.fit.at_bound and found.fit.lens.focus_disparity < 0.1 and found.fit.lens.aperture == 3.0


def test_a_sharp_photograph_is_predicted_without_a_lens() -> None:
    sharp = Known().render(CAMERA, None).image
    found = predict(Known(), CAMERA, sharp, 30.0, THOROUGH)
    assert found.fit.lens is None and not found.fit.at_bound and found.refused == ""
    assert np.array_equal(found.picture, found.sharp) and prediction_scores(found, sharp)["photo_psnr"] > 45


def test_the_half_that_is_scored_is_never_looked_at() -> None:
    found = predict(Known(), CAMERA, PHOTOGRAPH, 7.5, THOROUGH)
    own = found.tiles.fitted
    changed = np.where(own[..., None], PHOTOGRAPH, 1 - PHOTOGRAPH)
    again = predict(Known(), CAMERA, changed, 7.5, THOROUGH)
    assert again.fit.lens == found.fit.lens and again.fit.cost == found.fit.cost, "to the bit"
    assert np.array_equal(again.picture, found.picture) and np.array_equal(again.sharp, found.sharp)
    other = predict(Known(), CAMERA, np.where(own[..., None], 1 - PHOTOGRAPH, PHOTOGRAPH), 7.5, THOROUGH)
    assert not np.array_equal(other.picture, found.picture)


def test_the_picture_is_one_rendering_by_one_lens() -> None:
    found = predict(Known(), CAMERA, PHOTOGRAPH, 7.5, THOROUGH)
    rendered = Known().render(CAMERA, found.fit.lens).image
    # An affine map of colours apart, fitted to 8 bits on both sides.
    x = np.concatenate([rendered.reshape(-1, 3), np.ones((rendered[..., 0].size, 1))], axis=1)
    _, residual, *_ = np.linalg.lstsq(x, found.picture.reshape(-1, 3), rcond=None)
    assert np.sqrt(residual / len(x)).max() < 1 / 255


def test_a_search_at_a_reduced_size_is_bounded_and_looks_at_no_other_half() -> None:
    large = Camera(385, 83, 400.0, 400.0, 192.0, 41.0, np.eye(4))  # cells of 2 x 2 pixels, and a rest
    lens = PhysicalLens(14.0, 0.35, large.width)
    photograph, method = Known().render(large, lens).image, Known()
    found = predict(method, large, photograph, 15.0, QUICK)
    assert method.rendered.count(385) == 2 + QUICK.fine
    assert len(method.rendered) <= 3 + QUICK.focuses + QUICK.coarse + QUICK.fine
    assert found.fit.lens.focus_disparity == pytest.approx(0.35, abs=2 * FITTED_FOCUS)
    changed = photograph.copy()
    changed[~found.tiles.fitted] = 0.3
    assert predict(Known(), large, changed, 15.0, QUICK).fit.lens == found.fit.lens


class Slow(Known):
    """Its photographs have a border that its sketches lack; `photographs` counts them."""

    def __init__(self) -> None:
        super().__init__()
        self.photographs: list[PhysicalLens] = []

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        found = super().render(camera, lens)
        if lens is not None:
            self.photographs.append(lens)
            found.image[:, :1] = 0.5
        return found

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        return Rendering(defocus_numpy(sharp.image, sharp.depth, lens)[0], sharp.depth)


@pytest.mark.parametrize("width", [WIDTH, 385])
def test_a_slow_method_is_searched_by_its_sketches_and_scored_by_its_photographs(width: int) -> None:
    camera = CAMERA if width == WIDTH else Camera(width, 83, 400.0, 400.0, 192.0, 41.0, np.eye(4))
    lens = PhysicalLens(TRUE.aperture * width / WIDTH, TRUE.focus_disparity, width)
    photograph, method = Known().render(camera, lens).image, Slow()
    found, quick = (predict(one, camera, photograph, lens.aperture, THOROUGH) for one in (method, Known()))
    assert len(method.photographs) == 1
    assert found.fit.lens == method.photographs[0] == quick.fit.lens
    assert found.fit.renders[1] == quick.fit.renders[1] + 1 and found.fit.cost > quick.fit.cost
    own, other = (one.picture[:, :1].std(axis=(0, 1)) for one in (found, quick))
    assert own.max() < other.min() / 5, "the border of the photographs, evenly grey"


@pytest.mark.parametrize(
    ("method", "aperture", "reason"),
    [(Known(lens=False), 7.0, "no lens here"), (Known(), None, "no learned aperture"),
     (Known(depth=False), 7.0, "neither depth nor learned foci")],
)  # fmt: skip
def test_a_method_without_a_lens_is_predicted_as_it_renders(method: Known, aperture: float | None, reason: str) -> None:
    found = predict(method, CAMERA, PHOTOGRAPH, aperture, THOROUGH)
    assert reason in found.refused and found.fit.lens is None
    scores = prediction_scores(found, PHOTOGRAPH)
    assert scores["photo_psnr"] == scores["photo_sharp_psnr"] < 34


def test_a_method_without_depth_is_searched_between_its_learned_foci() -> None:
    found = predict(Known(depth=False), CAMERA, PHOTOGRAPH, 7.0, THOROUGH, foci=[0.2, 0.8])
    assert found.fit.lens.focus_disparity == pytest.approx(TRUE.focus_disparity, abs=2 * FITTED_FOCUS)


def test_another_exposure_and_white_balance_change_no_score() -> None:
    gains = np.array([0.8, 0.9, 0.7], np.float32)
    plain = prediction_scores(predict(Known(), CAMERA, PHOTOGRAPH, 7.0, THOROUGH), PHOTOGRAPH)
    dim = encode(decode(PHOTOGRAPH) * gains).astype(np.float32)
    other = prediction_scores(predict(Known(), CAMERA, dim, 7.0, THOROUGH), dim)
    assert other["photo_psnr"] == pytest.approx(plain["photo_psnr"], abs=TWO_FITS_DB) and other["photo_psnr"] > 38


def test_what_isnt_finite_gives_no_score() -> None:
    found = predict(Known(nan=True), CAMERA, PHOTOGRAPH, 7.0, THOROUGH)
    assert found.picture is None and found.bad == 1
    assert all(math.isnan(value) for value in prediction_scores(found, PHOTOGRAPH).values())


def test_an_image_of_another_size_is_refused() -> None:
    class Small(Known):
        def render(self, camera, lens):
            return Rendering(np.zeros((4, 4, 3), np.float32), np.ones((4, 4), np.float32))

    with pytest.raises(ValueError, match="expected an image of shape"):
        predict(Small(), CAMERA, PHOTOGRAPH, 7.0, THOROUGH)


def test_a_masked_pixel_is_neither_fitted_nor_scored() -> None:
    mask = np.ones(PHOTOGRAPH.shape[:2], bool)
    mask[:, : WIDTH // 2] = False
    found = predict(Known(), CAMERA, PHOTOGRAPH, 7.0, THOROUGH, mask=mask)
    damaged = np.where(mask[..., None], PHOTOGRAPH, 0.0).astype(np.float32)
    again = predict(Known(), CAMERA, damaged, 7.0, THOROUGH, mask=mask)
    assert again.fit.lens == found.fit.lens and not (found.tiles.scored & ~mask).any()
    psnr = masked_psnr(found.picture, PHOTOGRAPH, found.tiles.scored)
    assert prediction_scores(again, damaged)["photo_psnr"] == psnr


# ---- the aperture that is predicted with ----


def view(name: str, exif: Exif | None = None, camera: Camera = CAMERA) -> SimpleNamespace:
    return SimpleNamespace(name=name, exif=exif, camera=camera)


LEARNED = {"a": PhysicalLens(13.0, 0.3, WIDTH), "b": PhysicalLens(14.0, 0.7, WIDTH), "c": PhysicalLens(31, 0.2, 192)}


def test_the_aperture_is_the_median_of_the_learned_ones() -> None:
    views = [view(name) for name in "abcd"]  # c has 15.5 at this width; d has no learned lens
    assert learned_aperture(LEARNED, views, view("t")) == pytest.approx(14.0)
    assert learned_aperture(None, views, view("t")) is None and learned_aperture({}, views, view("t")) is None


def test_the_aperture_is_scaled_by_f_numbers_and_focal_lengths_where_they_are_known() -> None:
    views = [view("a", Exif(f_number=2.0, focal_length=50.0)), view("b", Exif(f_number=4.0)), view("c")]
    test = view("t", Exif(f_number=8.0, focal_length=100.0))
    # a: 13 · (100 / 50) · 2 / 8 = 6.5; b: 14 · 4 / 8 = 7, its focal length is unknown; c has no f-number.
    assert learned_aperture(LEARNED, views, test) == pytest.approx((6.5 + 7.0) / 2)
    assert learned_aperture(LEARNED, views, test, by_exif=False) == pytest.approx(14.0)
    assert learned_aperture(LEARNED, views, view("t")) == pytest.approx(14.0), "the test view has no f-number"


def test_a_lens_learned_upright_is_transferred_by_its_opening() -> None:
    """The same opening on a camera with twice this one's focal length in pixels, at 3/4 of its width."""
    upright = replace(CAMERA, width=WIDTH * 3 // 4, height=WIDTH, fx=2 * CAMERA.fx, fy=2 * CAMERA.fy)
    learned = {"a": PhysicalLens(2 * 14.0, 0.4, upright.width)}
    assert learned_aperture(learned, [view("a", camera=upright)], view("t")) == pytest.approx(14.0)
