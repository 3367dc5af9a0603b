"""The scores of held-out photographs of unknown lens, by column, and what was fitted to get them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dofbench.contracts import Method
from dofbench.harness.result import HalfFitted, ViewFit
from dofbench.photographs.predict import Prediction, predict
from dofbench.photographs.search import QUICK, THOROUGH
from dofbench.photographs.tiles import Tiles, masked_psnr, tiled_ssim
from dofbench.synthesis.dataset import Dataset, DatasetView

CURVE_VIEWS = 4  # test views that are predicted during training, evenly over all: a search takes seconds


def predicted(
    method: Method, dataset: Dataset, views: Sequence[DatasetView], *, no_lens: str, quick: bool,
) -> Iterator[tuple[DatasetView, np.ndarray, Prediction]]:
    """Each view, its photograph, and what the method predicts of it. no_lens: why it has no lens, if that is
    known. quick: a shorter search, of a few views only."""
    learned = method.lens_estimates()
    step = max(1, math.ceil(len(views) / CURVE_VIEWS)) if quick else 1
    for view in views[::step]:
        photograph = dataset.image(view)
        yield view, photograph, predict(method, view.camera, photograph, learned, QUICK if quick else THOROUGH,
                                        no_lens=no_lens)


def picture_scores(picture: np.ndarray, photograph: np.ndarray) -> dict[str, float]:
    """photo_psnr and photo_ssim of an assembled picture, (H, W, 3), encoded, at 8-bit levels."""
    tiles = Tiles.of(*photograph.shape[:2])
    return {"photo_psnr": masked_psnr(picture, photograph, tiles.inside),
            "photo_ssim": tiled_ssim(picture, photograph, tiles)}


def prediction_scores(found: Prediction, photograph: np.ndarray) -> dict[str, float]:
    """`PHOTOGRAPH_COLUMNS` of one view, the last one only where the method has a lens; NaN where a rendering wasn't
    finite."""
    if found.picture is None or found.blurred is None:
        columns = ("photo_psnr", "photo_ssim", *(() if found.refused else ("photo_blur_psnr",)))
        return dict.fromkeys(columns, math.nan)
    scores = picture_scores(found.picture, photograph)
    if not found.refused:
        scores["photo_blur_psnr"] = masked_psnr(found.blurred, photograph, found.tiles.inside)
    return scores


def view_fit(name: str, found: Prediction) -> ViewFit:
    """What was fitted of a view, for the result."""
    return ViewFit(name=name, seconds=found.seconds, halves=[
        HalfFitted(
            fitted_on=half.fitted_on, aperture=None if half.lens is None else half.lens.aperture,
            focus_disparity=None if half.lens is None else half.lens.focus_disparity, sigma=half.sigma,
            renders=sum(half.renders), error=half.cost,
        ) for half in found.halves
    ])
