"""Image and lens metrics by id: unit, direction, range, inputs. Importing this loads no heavy package.

An image metric takes two encoded images (H, W, 3) in [0, 1], float32 or float64, and computes in float64. Images aren't
rounded or clipped here. A NaN in either image gives NaN.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from dofbench.core.errors import InputError, unknown
from dofbench.core.similarity import psnr, ssim
from dofbench.evaluation.metrics.flip import flip
from dofbench.evaluation.metrics.image_metrics import delta_e, gmsd, ms_ssim, ssim_uniform7

__all__ = ["COLUMN_DATA", "METRICS", "Metric", "metric", "score_image"]


class ImageMetric(Protocol):
    """Scores two images (H, W, 3). mask: (H, W) bool, True for the pixels to score; it isn't passed where all are."""

    def __call__(self, prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None, /) -> float:
        """The score."""


@dataclass(frozen=True)
class Metric:
    """A column of a table.

    unit: empty for a plain number. best, worst: ends of the range. needs: "images", a prediction and its truth, for
    `function`, which else is None; "lens" (`lens_errors`), "depth" (`depth_errors`) or "exif" (`exif_errors`);
    "weights", images and a user's weights (`lpips`).
    note: footnote of a table. digits: decimals in tables.
    """

    id: str
    label: str
    unit: str
    higher_is_better: bool
    best: float
    worst: float
    needs: Literal["images", "lens", "depth", "exif", "weights"]
    function: ImageMetric | None
    note: str
    digits: int = 4


# Texts, units and digits of all columns, by table and id.
COLUMN_DATA: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).parents[1].joinpath("columns.toml").read_text(encoding="utf-8")
)
_FUNCTIONS: dict[str, ImageMetric] = {
    "psnr": psnr,
    "ssim": ssim,
    "ssim_uniform7": ssim_uniform7,
    "ms_ssim": ms_ssim,
    "flip": flip,
    "gmsd": gmsd,
    "delta_e": delta_e,
}
METRICS: dict[str, Metric] = {
    id: Metric(id, label, unit, best > worst, float(best), float(worst), needs, _FUNCTIONS.get(id), note, digits)
    for id, (label, unit, worst, best, digits, needs, note) in COLUMN_DATA["metrics"].items()
}


def metric(metric_id: str) -> Metric:
    """The metric of this id. Raises InputError for an unknown one."""
    if metric_id not in METRICS:
        raise unknown("metric", metric_id, METRICS)
    return METRICS[metric_id]


def score_image(
    prediction: np.ndarray, truth: np.ndarray, ids: Iterable[str], mask: np.ndarray | None = None
) -> dict[str, float]:
    """Image metrics by id, in the order of `ids`, of two encoded images (H, W, 3) in [0, 1].

    mask: (H, W) bool, True for scored pixels; None for all. Raises InputError for an unknown id or one that needs more
    than images, ValueError for shapes that don't fit.
    """
    scores = {}
    for metric_id in ids:
        function = metric(metric_id).function
        if function is None:
            raise InputError("metric", f"{metric_id!r}, which needs lenses, depth or weights", "a metric of images")
        scores[metric_id] = function(prediction, truth) if mask is None else function(prediction, truth, mask)
    return scores
