"""Scores of one render against one photograph, region by region."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np

from dofbench.metrics.flip import flip_map
from dofbench.metrics.ssim import ssim_map
from dofbench.validation.regions import regions
from dofbench.validation.truth import Truth
from dofbench.validation.variants import VARIANTS

_LEAST_PIXELS = 200  # in a region: fewer say nothing
_TIMED = 3           # calls of a renderer; the median counts


@dataclass(frozen=True)
class Score:
    """One row of renderer.csv. aperture: largest radius, pixels; seconds: of one render, a megapixel."""

    source: str
    name: str
    aperture: float
    focus: float
    variant: str
    region: str
    pixels: int
    psnr: float
    ssim: float
    flip: float
    seconds_per_megapixel: float
    truth_psnr: float


def score(truth: Truth) -> Iterator[tuple[Score, np.ndarray]]:
    """Every variant's scores in every region that the photograph has, and its render, (H, W, 3) in [0, 1]."""
    masks = {name: mask for name, mask in regions(truth.signed_radius, truth.border).items()
             if mask.sum() >= _LEAST_PIXELS}
    megapixels = truth.signed_radius.size / 1e6
    for variant, render in VARIANTS.items():
        render(truth)  # the first call may compile
        seconds = []
        for _ in range(_TIMED):
            start = perf_counter()
            image = render(truth)
            seconds.append(perf_counter() - start)
        image = np.clip(image, 0, 1).astype(np.float32)
        squared = ((image - truth.photograph).astype(np.float64) ** 2).mean(axis=2)
        similar = np.full(squared.shape, np.nan)
        similar[5:-5, 5:-5] = ssim_map(image, truth.photograph).mean(axis=2)
        visible = flip_map(image, truth.photograph)
        for region, mask in masks.items():
            error = squared[mask].mean()
            yield Score(
                truth.source, truth.name, truth.aperture, truth.focus, variant, region, int(mask.sum()),
                -10 * math.log10(error) if error > 0 else math.inf,
                float(np.nanmean(similar[mask])), float(visible[mask].mean(dtype=np.float64)),
                median(seconds) / megapixels, truth.own_error_db,
            ), image
