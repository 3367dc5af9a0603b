"""Scores and fits of held-out real photographs of unknown lens."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from dofbench.core.contracts import Method
from dofbench.core.images import from_8bit, to_8bit
from dofbench.core.lens import PhysicalLens
from dofbench.core.masks import filled
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset, BenchmarkView
from dofbench.evaluation.results.protocol import (
    ACROSS_PREFIX,
    BLUR_COLUMNS,
    PHOTO_PREFIX,
    PHOTOGRAPH_COLUMNS,
    PICTURE_BLUR,
)
from dofbench.evaluation.results.result import HalfFitted, ViewFit
from dofbench.evaluation.scoring.photographs.band_energies import band_ratios
from dofbench.evaluation.scoring.photographs.colour_fit import with_contrast
from dofbench.evaluation.scoring.photographs.coverage import Frame, covered
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, masked_psnr, tiled_ssim
from dofbench.evaluation.scoring.photographs.learned_aperture import learned_aperture
from dofbench.evaluation.scoring.photographs.lens_evidence import energies
from dofbench.evaluation.scoring.photographs.predict import Prediction, predict, recoloured_by
from dofbench.evaluation.scoring.photographs.search import QUICK, THOROUGH
from dofbench.evaluation.scoring.photographs.strata import sharpness_ratio, thirds

CURVE_VIEWS = 4  # evenly spaced test views that are predicted during training; a search takes seconds
FIT_VIEWS = 8  # training views, at most, that are predicted as test views are: the fit ceiling
BLURRED, CLEAR = 0, 2  # indices of the thirds of a view (`strata.thirds`)
NO_STRATA = "too few sparse points in views of both apertures to measure their blur"
NO_TEXTURE = "the scored tiles of a test view have no texture"
NO_COVERAGE = "too few sparse points in a test view to know what the training views cover of it"


@dataclass(frozen=True, eq=False)
class Scored:
    """One scored test view. scores: by column, as far as they can be computed. energies: of blur and error
    (`lens_evidence.energies`); None where no lens was tried."""

    view: BenchmarkView
    photograph: np.ndarray
    prediction: Prediction
    scores: dict[str, float]
    energies: tuple[float, float] | None = None

    @property
    def fit(self) -> ViewFit:
        """The fit as stored in the result."""
        fit = self.prediction.fit
        halves = [] if fit is None else [
            HalfFitted(
                fitted_on=0,
                aperture=None if fit.lens is None else fit.lens.aperture,
                focus_disparity=None if fit.lens is None else fit.lens.focus_disparity,
                sigma=None,
                at_bound=fit.at_bound,
                renders=sum(fit.renders),
                error=fit.cost,
            )
        ]  # fmt: skip
        return ViewFit(name=self.view.name, seconds=self.prediction.seconds, halves=halves)


class ScoredPixels:
    """Which pixels of a dataset's test views are scored: valid ones that some training view covers, as far as known.

    both: as `Tiles`; up to `photographs-v1` all valid pixels, whatever the training views cover.
    """

    def __init__(self, dataset: BenchmarkDataset, *, both: bool = False):
        self._dataset, self._both = dataset, both
        self._found: dict[str, tuple[np.ndarray | None, float | None]] = {}

    @cached_property
    def _frames(self) -> list[Frame]:
        views = self._dataset.training_views()
        return [(view.camera, self._dataset.mask(view) if view.has_mask else None) for view in views]

    def of(self, view: BenchmarkView) -> tuple[np.ndarray | None, float | None]:
        """The scored pixels of a view, (H, W), or None for all; and their share of the valid ones, %, None if unknown.
        Where nothing is covered, the share is 0 and all valid pixels are scored."""
        if view.name not in self._found:
            self._found[view.name] = self._covered(view)
        return self._found[view.name]

    def tiles(self, view: BenchmarkView) -> Tiles:
        """The tiles of a view."""
        return Tiles.of(view.camera.height, view.camera.width, self.of(view)[0], both=self._both)

    def _covered(self, view: BenchmarkView) -> tuple[np.ndarray | None, float | None]:
        valid, points = self._dataset.mask(view), self._dataset.points
        shown = None if self._both or points is None else covered(points, view.camera, self._frames)
        if shown is None:
            return valid, None
        kept = shown if valid is None else shown & valid
        share = 100 * np.count_nonzero(kept) / (kept.size if valid is None else np.count_nonzero(valid))
        return (kept if kept.any() else valid), float(share)


def scored_photographs(
    method: Method,
    dataset: BenchmarkDataset,
    columns: Sequence[str],
    *,
    no_lens: str,
    quick: bool,
    pixels: ScoredPixels | None = None,
) -> Iterator[Scored]:
    """The test views, predicted and scored. columns: of the protocol. no_lens: why the method has no lens, if known.
    quick: a few views with a shorter search. pixels: the dataset's, where they are kept from call to call."""
    test = dataset.test_views()
    views = test[:: max(1, math.ceil(len(test) / CURVE_VIEWS))] if quick else test
    across = tuple(columns) != PHOTOGRAPH_COLUMNS
    learned, training = method.lens_estimates(), dataset.training_views()
    foci = [lens.focus_disparity for lens in (learned or {}).values()]
    pixels = pixels or ScoredPixels(dataset)
    strata = blurred_thirds(dataset, pixels) if across and not quick else {}
    predicted = partial(predict, method, effort=QUICK if quick else THOROUGH, foci=foci, no_lens=no_lens)
    for view in views:
        photograph, (mask, share) = true_photograph(dataset, view), pixels.of(view)
        found = predicted(view.camera, photograph, learned_aperture(learned, training, view), mask=mask)
        lensed = found.picture
        if across:
            unscaled = None
            if not (quick or found.refused):
                aperture = learned_aperture(learned, training, view, by_exif=False)
                unscaled = predicted(view.camera, photograph, aperture, mask=mask).picture
                lensed = _as_trained(method, view, aperture, foci, photograph, found)
            scores = _across_scores(found, unscaled, photograph, strata.get(view.name), quick=quick)
        else:
            scores = prediction_scores(found, photograph) | ({} if quick else prediction_blur(found, photograph))
        if not found.refused:
            scores |= _lens_shares(found)
        both = None
        if not (quick or found.refused or lensed is None or found.sharp is None):
            both = energies(lensed, found.sharp, photograph, found.tiles.scored)
        yield Scored(view, photograph, found, scores | ({} if share is None else {"photo_covered": share}), both)


def fit_views(dataset: BenchmarkDataset) -> list[BenchmarkView]:
    """Evenly spaced training views for `fit_ceiling`: as many as test views, at most `FIT_VIEWS`."""
    training = dataset.training_views()
    count = min(len(training), len(dataset.test_views()), FIT_VIEWS)
    chosen = np.linspace(0, len(training) - 1, count).round().astype(int)
    return [training[index] for index in chosen]


def fit_ceiling(
    method: Method, dataset: BenchmarkDataset, views: Iterable[BenchmarkView], *, no_lens: str
) -> float | None:
    """Mean PSNR of training photographs, predicted by the rules for test photographs, dB: what the model fits of what
    it has seen. None without any, and for a non-finite rendering. no_lens: as `scored_photographs`."""
    training, learned = dataset.training_views(), method.lens_estimates()
    foci = [lens.focus_disparity for lens in (learned or {}).values()]
    psnr = []
    for view in views:
        photograph, aperture = true_photograph(dataset, view), learned_aperture(learned, training, view)
        mask = dataset.mask(view)
        found = predict(method, view.camera, photograph, aperture, THOROUGH, foci=foci, no_lens=no_lens, mask=mask)
        if found.picture is None:
            return None
        psnr.append(masked_psnr(found.picture, photograph, found.tiles.scored))
    return float(np.mean(psnr)) if psnr else None


def _as_trained(
    method: Method,
    view: BenchmarkView,
    aperture: float | None,
    foci: Sequence[float],
    photograph: np.ndarray,
    found: Prediction,
) -> np.ndarray | None:
    """The view as the training views are blurred: by the aperture and the median of the foci, colours fitted; None for
    a non-finite rendering."""
    if aperture is None or found.sharp is None:
        return None
    lens = PhysicalLens(aperture, float(np.median(foci)), view.camera.width)
    image = method.render(view.camera, lens).image
    return recoloured_by(image, photograph, found.tiles) if np.isfinite(image).all() else None


def true_photograph(dataset: BenchmarkDataset, view: BenchmarkView) -> np.ndarray:
    """The photograph, (H, W, 3), encoded; masked pixels replaced by the nearest valid ones."""
    photograph, mask = dataset.image(view), dataset.mask(view)
    return photograph if mask is None else filled(photograph, mask)


def picture_scores(picture: np.ndarray, photograph: np.ndarray, prefix: str, tiles: Tiles) -> dict[str, float]:
    """PSNR and SSIM of an image, (H, W, 3), encoded, at 8-bit levels, over the scored tiles."""
    return {
        f"{prefix}psnr": masked_psnr(picture, photograph, tiles.scored),
        f"{prefix}ssim": tiled_ssim(picture, photograph, tiles),
    }


def prediction_scores(found: Prediction, photograph: np.ndarray) -> dict[str, float]:
    """PSNR and SSIM by the fitted lens and without a lens; NaN for a non-finite rendering."""
    scores: dict[str, float] = {}
    for prefix, picture in ((PHOTO_PREFIX, found.picture), ("photo_sharp_", found.sharp)):
        if picture is None:
            scores |= {f"{prefix}psnr": math.nan, f"{prefix}ssim": math.nan}
        else:
            scores |= picture_scores(picture, photograph, prefix, found.tiles)
    return scores


def picture_blur(picture: np.ndarray, photograph: np.ndarray, tiles: Tiles) -> dict[str, float]:
    """`PICTURE_BLUR` of an image, (H, W, 3), encoded, at 8-bit levels, with the photograph's contrast; none where the
    photograph has no texture."""
    # A file's reader may differ from `from_8bit` by a float32's last digit, which shows where the mean is near zero.
    own, true = (from_8bit(to_8bit(image)) for image in (picture, photograph))
    found = band_ratios(with_contrast(own, true, tiles.fitted), true, tiles)
    if not found.ratios.size:
        return {}
    return dict(zip(PICTURE_BLUR, (float(found.errors.mean()), float(found.excess.mean())), strict=True))


def prediction_blur(found: Prediction, photograph: np.ndarray) -> dict[str, float]:
    """`BLUR_COLUMNS`, as far as the photograph has texture; NaN for a non-finite rendering."""
    if found.picture is None or found.sharp is None:
        return dict.fromkeys(BLUR_COLUMNS, math.nan)
    scores = picture_blur(found.picture, photograph, found.tiles)
    plain = scores if found.sharp is found.picture else picture_blur(found.sharp, photograph, found.tiles)
    return scores | ({"photo_sharp_blur": plain["photo_blur"]} if plain else {})


def _lens_shares(found: Prediction) -> dict[str, float]:
    """What the means over views make the shares of views without a fitted lens and with one at its bound, %."""
    fit = found.fit
    if found.picture is None or fit is None:
        return {"photo_no_lens": math.nan, "photo_at_bound": math.nan}
    return {"photo_no_lens": 100.0 * (fit.lens is None), "photo_at_bound": 100.0 * fit.at_bound}


def _across_scores(
    found: Prediction,
    unscaled: np.ndarray | None,
    photograph: np.ndarray,
    third: np.ndarray | None,
    *,
    quick: bool,
) -> dict[str, float]:
    """Scores over all scored pixels and over the thirds; `unscaled` is None where it isn't predicted or not finite."""
    pictures = {ACROSS_PREFIX: found.picture, "in_focus_": found.sharp}
    if not (quick or found.refused):
        pictures["unscaled_"] = unscaled
    masks = {"psnr": found.tiles.scored, **({} if third is None else {"blurred_psnr": third == BLURRED})}
    scores = {
        prefix + name: math.nan if picture is None else masked_psnr(picture, photograph, pixels)
        for prefix, picture in pictures.items()
        for name, pixels in masks.items()
    }
    picture = found.picture
    if third is not None:
        clear = math.nan if picture is None else masked_psnr(picture, photograph, third == CLEAR)
        scores["across_clear_psnr"] = clear
    scores["across_ssim"] = math.nan if picture is None else tiled_ssim(picture, photograph, found.tiles)
    return scores


def blurred_thirds(dataset: BenchmarkDataset, pixels: ScoredPixels) -> dict[str, np.ndarray]:
    """The map of thirds (`strata.thirds`) of every test view's scored pixels, by name; empty unless all have one."""
    if dataset.points is None:
        return {}
    shots = {
        split: [
            (view.camera, true_photograph(dataset, view), dataset.mask(view))
            for view in dataset.views
            if view.split == split
        ]
        for split in ("train", "test")
    }
    ratio = sharpness_ratio(dataset.points, shots["train"], shots["test"])
    found = {}
    for view in dataset.test_views():
        third = thirds(dataset.points, ratio, view.camera, pixels.tiles(view).scored)
        if third is None:
            return {}
        found[view.name] = third
    return found
