"""Scores of one render against one photograph, region by region."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from time import perf_counter

import numpy as np

from dofbench.core.similarity import ssim_map
from dofbench.evaluation.metrics.flip import flip_map
from dofbench.evaluation.renderer.regions import regions
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.evaluation.renderer.variants import Variant

_LEAST_PIXELS = 200  # fewest pixels of a region that is scored
_TIMED = 3  # timed calls of a renderer, of which the median is taken
_ENOUGH_SECONDS = 1.0  # seconds: a renderer that takes longer is timed once
_called: set[str] = set()


@dataclass(frozen=True)
class Score:
    """One row of renderer.csv.

    aperture, focus: in the source's units. radius: largest radius of the photograph, pixels. seconds_per_megapixel:
    time of one render. truth_psnr: dB, of the photograph's own noise; NaN if unknown.
    """

    source: str
    name: str
    view: str
    aperture: float
    focus: float
    radius: float
    variant: str
    region: str
    pixels: int
    psnr: float
    ssim: float
    flip: float
    seconds_per_megapixel: float
    truth_psnr: float


def score(case: Case, truth: Truth, variant: Variant) -> tuple[list[Score], np.ndarray]:
    """A variant's scores in every region that the photograph has, and its render, (H, W, 3) in [0, 1]."""
    image, seconds = _timed(variant, truth)
    image = np.clip(image, 0, 1).astype(np.float32)
    squared = ((image - truth.photograph).astype(np.float64) ** 2).mean(axis=2)
    similar = np.full(squared.shape, np.nan)
    similar[5:-5, 5:-5] = ssim_map(image, truth.photograph).mean(axis=2)
    visible = flip_map(image, truth.photograph)
    radius = float(np.abs(truth.signed_radius).max())
    rows = []
    for region, mask in regions(truth.signed_radius, truth.border).items():
        pixels = int(mask.sum())
        if pixels < _LEAST_PIXELS:
            continue
        error = squared[mask].mean()
        rows.append(
            Score(
                case.source,
                case.name,
                case.view,
                case.aperture,
                case.focus,
                radius,
                variant.name,
                region,
                pixels,
                -10 * math.log10(error) if error > 0 else math.inf,
                float(np.nanmean(similar[mask])),
                float(visible[mask].mean(dtype=np.float64)),
                seconds / (squared.size / 1e6),
                truth.own_error_db,
            )
        )
    return rows, image


def _timed(variant: Variant, truth: Truth) -> tuple[np.ndarray, float]:
    if variant.name not in _called:
        variant.render(truth)  # the first call may compile
        _called.add(variant.name)
    seconds: list[float] = []
    while len(seconds) < _TIMED and sum(seconds) < _ENOUGH_SECONDS:
        start = perf_counter()
        image = variant.render(truth)
        seconds.append(perf_counter() - start)
    return image, median(seconds)
