"""Image and lens metrics by id: unit, direction, range and what each needs. Importing this loads no heavy package.

An image metric takes two encoded images (H, W, 3) with values in [0, 1], float32 or float64, and
computes in float64. The caller rounds or clips to that range first, as its protocol says; nothing
here does. A NaN in either image gives NaN, never a number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from dofbench.core.errors import InputError, unknown
from dofbench.core.similarity import psnr, ssim
from dofbench.evaluation.metrics.delta_e import delta_e
from dofbench.evaluation.metrics.flip import flip
from dofbench.evaluation.metrics.gmsd import gmsd
from dofbench.evaluation.metrics.ms_ssim import ms_ssim
from dofbench.evaluation.metrics.ssim_uniform7 import ssim_uniform7

__all__ = ["METRICS", "Metric", "metric", "score_image"]


class ImageMetric(Protocol):
    """Scores two images (H, W, 3). mask: (H, W) bool, True for the pixels to score; it isn't passed where all are."""

    def __call__(self, prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None, /) -> float:
        """The score."""


@dataclass(frozen=True)
class Metric:
    """A column of a table.

    unit: empty for a plain number. higher_is_better: which way is better. best, worst: the ends of the range.
    needs: "images", a prediction and its truth, for `function`; "lens", true and learned lenses, for
    `lens_errors.lens_errors`, and "depth", rendered and exact depth, for `depth_errors`, and "exif", learned
    lenses and what the camera wrote down, for `exif_errors` and `exif_focus_errors`, where `function` is
    None. note: the choices behind the number, for the foot of a table.
    """

    id: str
    label: str
    unit: str
    higher_is_better: bool
    best: float
    worst: float
    needs: Literal["images", "lens", "depth", "exif"]
    function: ImageMetric | None
    note: str


METRICS: dict[str, Metric] = {
    entry.id: entry
    for entry in (
        Metric("psnr", "PSNR", "dB", True, math.inf, 0.0, "images", psnr, "over all pixels and channels, peak 1"),
        Metric(
            "ssim",
            "SSIM",
            "",
            True,
            1.0,
            -1.0,
            "images",
            ssim,
            "Gaussian window 11, sigma 1.5, data range 1, population covariance, border cropped; "
            "mean over channels; equals scikit-image",
        ),
        Metric(
            "ssim_uniform7",
            "SSIM, uniform window 7",
            "",
            True,
            1.0,
            -1.0,
            "images",
            ssim_uniform7,
            "as the released script of DoF-Gaussian measures SSIM: scikit-image's defaults (uniform window 7, sample "
            "covariance) on images stretched to -1 ... 1",
        ),
        Metric(
            "ms_ssim",
            "MS-SSIM",
            "",
            True,
            1.0,
            0.0,
            "images",
            ms_ssim,
            "5 scales, or as many as leave 11 pixels (5 from 176 pixels on the shorter side), the weights "
            "scaled to sum to one; windows as in SSIM; mean over channels",
        ),
        Metric(
            "flip", "FLIP", "", False, 0.0, 1.0, "images", flip, "LDR-FLIP, 67 pixels per degree, mean of the error map"
        ),
        Metric(
            "gmsd",
            "GMSD",
            "",
            False,
            0.0,
            0.5,
            "images",
            gmsd,
            "on Rec. 601 luma, halved once, c = 170 on a scale of 255",
        ),
        Metric(
            "delta_e",
            "ΔE00",
            "",
            False,
            0.0,
            math.inf,
            "images",
            delta_e,
            "CIEDE2000, mean over pixels; pixels taken as sRGB, D65",
        ),
        Metric("delta_a", "δ_A", "", False, 0.0, math.inf, "lens", None, "mean |A - Â| over the training views"),
        Metric(
            "delta_f",
            "δ_F",
            "",
            False,
            0.0,
            math.inf,
            "lens",
            None,
            "mean |F - F̂| over the training views, normalised disparity of the dataset",
        ),
        Metric(
            "delta_r",
            "δ_R",
            "px",
            False,
            0.0,
            math.inf,
            "lens",
            None,
            "mean |R - R̂| over all pixels of known depth of the training views",
        ),
        Metric(
            "disparity_error",
            "disparity error",
            "",
            False,
            0.0,
            math.inf,
            "depth",
            None,
            "mean |d - d̂| over the test views' pixels of known depth, normalised disparity of the dataset, the "
            "unit of δ_F; where nothing was rendered, infinitely far",
        ),
        Metric(
            "depth_rel",
            "depth AbsRel",
            "",
            False,
            0.0,
            math.inf,
            "depth",
            None,
            "mean |z - ẑ| / z over the test views' pixels of known depth; where nothing was rendered, 1",
        ),
        Metric(
            "exif_spread",
            "aperture spread",
            "%",
            False,
            0.0,
            math.inf,
            "exif",
            None,
            "of learned aperture × f-number over the training views of one f-number: 1.4826 × median absolute "
            "deviation / median; mean over f-numbers of 3 views or more, weighted by views",
        ),
        Metric(
            "exif_ratio",
            "aperture ratio error",
            "%",
            False,
            0.0,
            math.inf,
            "exif",
            None,
            "between f-numbers of 3 training views or more, of median learned aperture × f-number: by how much the "
            "largest is above the smallest",
        ),
        Metric(
            "exif_focus",
            "focus rank correlation",
            "",
            True,
            1.0,
            -1.0,
            "exif",
            None,
            "Spearman's, of the training views' learned focus disparity and 1 / focus distance in EXIF; 5 views and 3 "
            "different distances or more",
        ),
        Metric(
            "exif_focus_scatter",
            "focus scatter",
            "%",
            False,
            0.0,
            math.inf,
            "exif",
            None,
            "of the same: standard deviation of the learned focus disparity about the best scale × (1 / distance) + "
            "offset, over its mean",
        ),
    )
}


def metric(metric_id: str) -> Metric:
    """The metric of that id. Raises InputError for an unknown one."""
    if metric_id not in METRICS:
        raise unknown("metric", metric_id, METRICS)
    return METRICS[metric_id]


def score_image(
    prediction: np.ndarray, truth: np.ndarray, ids: Iterable[str], mask: np.ndarray | None = None
) -> dict[str, float]:
    """The image metrics named by `ids`, in that order, of two encoded images (H, W, 3) in [0, 1].

    mask: (H, W) bool, True for the pixels that are scored; None for all. What is under it has no influence.
    Raises InputError for an unknown id or one that needs more than images, ValueError for shapes
    that don't fit.
    """
    scores = {}
    for metric_id in ids:
        function = metric(metric_id).function
        if function is None:
            raise InputError("metric", f"{metric_id!r}, which needs lenses or depth", "a metric of images")
        scores[metric_id] = function(prediction, truth) if mask is None else function(prediction, truth, mask)
    return scores
