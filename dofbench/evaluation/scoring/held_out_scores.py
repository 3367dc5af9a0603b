"""Scores on held-out pixels of the training views, the same for every method."""

from __future__ import annotations

import math

import numpy as np

from dofbench.core.contracts import Method, PredictsPhotographs
from dofbench.core.held_out import tile_scores
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.inputs import Inputs
from dofbench.evaluation.results.columns import HELD_OUT_SCORES

NO_PREDICTION = "the method doesn't predict its training views"


def held_out_scores(
    method: Method, dataset: Dataset, inputs: Inputs, share: float
) -> tuple[dict[str, float], dict[str, str]]:
    """(scores, reasons for missing ones) by column, of a method that was trained without a `share` of the pixels.

    Means over the views that have such pixels; of SSIM over those with a tile that isn't cut by the image's border.
    """
    if not isinstance(method, PredictsPhotographs):
        return {}, dict.fromkeys(HELD_OUT_SCORES, NO_PREDICTION)
    views = {view.name: view for view in dataset.training_set(inputs).views}
    pairs = []
    for name, pixels in dataset.held_out(share).items():
        if pixels.any():
            prediction, image = method.predict_photograph(name, pixels), views[name].image
            pairs.append(tile_scores(np.where(pixels[..., None], prediction.clip(0, 1), image), image, pixels))
    if not pairs:
        return {}, dict.fromkeys(HELD_OUT_SCORES, "no view has pixels to hold out")
    psnr, ssim = zip(*pairs, strict=True)
    whole = [value for value in ssim if not math.isnan(value)]
    scores = {HELD_OUT_SCORES[0]: float(np.mean(psnr))}
    if not whole:
        return scores, {HELD_OUT_SCORES[1]: "no held-out tile holds a window"}
    return {**scores, HELD_OUT_SCORES[1]: float(np.mean(whole))}, {}
