"""Scores and fits of held-out real photographs of unknown lens."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method
from dofbench.core.masks import filled
from dofbench.datasets.format.benchmark_dataset import BenchmarkDataset, BenchmarkView
from dofbench.evaluation.results.protocol import ACROSS_COLUMNS, ACROSS_PREFIX, PHOTO_PREFIX
from dofbench.evaluation.results.result import HalfFitted, ViewFit
from dofbench.evaluation.scoring.ground_truth import training_f_number
from dofbench.evaluation.scoring.photographs.across import FOCUS_EFFORT, QUICK_FOCUS_EFFORT, predict_across
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, masked_psnr, tiled_ssim
from dofbench.evaluation.scoring.photographs.predict import Prediction, predict
from dofbench.evaluation.scoring.photographs.search import QUICK, THOROUGH
from dofbench.evaluation.scoring.photographs.strata import sharpness_ratio, thirds

CURVE_VIEWS = 4  # evenly spaced test views that are predicted during training; a search takes seconds
BLURRED, CLEAR = 0, 2  # indices of the thirds of a view (`strata.thirds`)
NO_STRATA = "too few sparse points in views of both apertures to measure their blur"


@dataclass(frozen=True, eq=False)
class Scored:
    """One scored test view. scores: by column, as far as they can be computed."""

    view: BenchmarkView
    photograph: np.ndarray
    prediction: Prediction
    scores: dict[str, float]

    @property
    def fit(self) -> ViewFit:
        """The fit as stored in the result."""
        return ViewFit(
            name=self.view.name,
            seconds=self.prediction.seconds,
            halves=[
                HalfFitted(
                    fitted_on=half.fitted_on,
                    aperture=None if half.lens is None else half.lens.aperture,
                    focus_disparity=None if half.lens is None else half.lens.focus_disparity,
                    sigma=half.sigma,
                    renders=sum(half.renders),
                    error=half.cost,
                )
                for half in self.prediction.halves
            ],
        )


def scored_photographs(
    method: Method, dataset: BenchmarkDataset, columns: Sequence[str], *, no_lens: str, quick: bool
) -> Iterator[Scored]:
    """The test views, predicted and scored. columns: of the protocol. no_lens: why the method has no lens, if known.
    quick: a few views with a shorter search."""
    test = dataset.test_views()
    views = test[:: max(1, math.ceil(len(test) / CURVE_VIEWS))] if quick else test
    if tuple(columns) == ACROSS_COLUMNS:
        yield from _across(method, dataset, views, no_lens, quick)
        return
    learned, cameras = method.lens_estimates(), _training_cameras(dataset)
    for view in views:
        photograph, mask = true_photograph(dataset, view)
        effort = QUICK if quick else THOROUGH
        found = predict(method, view.camera, photograph, learned, effort, cameras=cameras, no_lens=no_lens, mask=mask)
        yield Scored(view, photograph, found, prediction_scores(found, photograph))


def true_photograph(dataset: BenchmarkDataset, view: BenchmarkView) -> tuple[np.ndarray, np.ndarray | None]:
    """The photograph, masked pixels replaced by the nearest valid ones, and the mask or None."""
    photograph, mask = dataset.image(view), dataset.mask(view)
    return (photograph if mask is None else filled(photograph, mask)), mask


def picture_scores(
    picture: np.ndarray, photograph: np.ndarray, prefix: str = PHOTO_PREFIX, mask: np.ndarray | None = None
) -> dict[str, float]:
    """PSNR and SSIM of an assembled image, (H, W, 3), encoded, at 8-bit levels. mask: (H, W), or None."""
    height, width = photograph.shape[:2]
    tiles = Tiles.of(height, width, mask)
    return {
        f"{prefix}psnr": masked_psnr(picture, photograph, tiles.inside),
        f"{prefix}ssim": tiled_ssim(picture, photograph, tiles),
    }


def prediction_scores(found: Prediction, photograph: np.ndarray) -> dict[str, float]:
    """`PHOTOGRAPH_COLUMNS` of one view, the last one only with a lens; NaN for a non-finite rendering."""
    if found.picture is None:
        columns = ("photo_psnr", "photo_ssim", *(() if found.refused else ("photo_blur_psnr",)))
        return dict.fromkeys(columns, math.nan)
    scores = picture_scores(found.picture, photograph, mask=found.tiles.mask)
    if not found.refused and found.blurred is not None:
        scores["photo_blur_psnr"] = masked_psnr(found.blurred, photograph, found.tiles.inside)
    return scores


def _across(
    method: Method, dataset: BenchmarkDataset, views: Sequence[BenchmarkView], no_lens: str, quick: bool
) -> Iterator[Scored]:
    learned, trained = method.lens_estimates(), training_f_number(dataset)
    strata, cameras = {} if quick else blurred_thirds(dataset), _training_cameras(dataset)
    for view in views:
        assert trained is not None and view.exif is not None and view.exif.f_number is not None
        photograph, mask = true_photograph(dataset, view)
        found = predict_across(
            method,
            view.camera,
            photograph,
            learned,
            trained / view.exif.f_number,
            QUICK_FOCUS_EFFORT if quick else FOCUS_EFFORT,
            cameras=cameras,
            no_lens=no_lens,
            unscaled=not quick,
            mask=mask,
        )
        inside, third = found.scaled.tiles.inside, strata.get(view.name)
        pictures = {ACROSS_PREFIX: found.scaled.picture, "in_focus_": found.in_focus}
        if found.unscaled is not None or not (found.scaled.refused or quick):
            pictures["unscaled_"] = found.unscaled.picture if found.unscaled is not None else None
        masks = {"psnr": inside}
        if third is not None:
            masks |= {"blurred_psnr": third == BLURRED, "clear_psnr": third == CLEAR}
        scores = {
            prefix + name: math.nan if picture is None else masked_psnr(picture, photograph, pixels)
            for prefix, picture in pictures.items()
            for name, pixels in masks.items()
            if prefix + name in ACROSS_COLUMNS
        }
        scaled = found.scaled.picture
        scores["across_ssim"] = math.nan if scaled is None else tiled_ssim(scaled, photograph, found.scaled.tiles)
        yield Scored(view, photograph, found.scaled, scores)


def _training_cameras(dataset: BenchmarkDataset) -> dict[str, Camera]:
    return {view.name: view.camera for view in dataset.training_views()}


def blurred_thirds(dataset: BenchmarkDataset) -> dict[str, np.ndarray]:
    """The map of thirds (`strata.thirds`) of every test view, by name; empty unless all have one."""
    if dataset.points is None:
        return {}
    shots = {
        split: [(view.camera, *true_photograph(dataset, view)) for view in dataset.views if view.split == split]
        for split in ("train", "test")
    }
    ratio = sharpness_ratio(dataset.points, shots["train"], shots["test"])
    found = {}
    for view in dataset.test_views():
        inside = Tiles.of(view.camera.height, view.camera.width, dataset.mask(view)).inside
        third = thirds(dataset.points, ratio, view.camera, inside)
        if third is None:
            return {}
        found[view.name] = third
    return found
