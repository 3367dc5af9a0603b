"""Errors of a rendered depth map over the pixels of known depth.

Disparity error: in the unit of focus; times K it is the error of the CoC radius in pixels.
Relative error: AbsRel of Eigen, Puhrsch, Fergus, "Depth map prediction from a single image", NIPS 2014, section 4.
"""

from __future__ import annotations

import math

import numpy as np

from dofbench.core.lens import DisparityRange

EMPTY_IS_INFINITELY_FAR = 0.0  # disparity of a pixel where nothing was rendered


def disparity_error(depth: np.ndarray, truth: np.ndarray, disparity_range: DisparityRange) -> float:
    """Mean |d - d_true|, normalised disparity of the dataset; 0 is best.

    depth, truth: (H, W), z in scene units, 0 where empty or unknown. An empty pixel is infinitely far. NaN for a NaN at
    a known pixel, or without known pixels. Raises ValueError for different shapes.
    """
    rendered, known = _known(depth, truth)
    if known.size == 0:
        return math.nan
    there = rendered != 0
    disparity = np.divide(1.0, rendered, out=np.full_like(rendered, EMPTY_IS_INFINITELY_FAR), where=there)
    return float(np.abs(disparity - 1.0 / known).mean() / disparity_range.extent)


def relative_error(depth: np.ndarray, truth: np.ndarray) -> float:
    """Mean |z - z_true| / z_true; 0 is best. A pixel without rendered depth (0) has an error of 1.

    Arguments, NaN and errors as in `disparity_error`.
    """
    rendered, known = _known(depth, truth)
    return float((np.abs(rendered - known) / known).mean()) if known.size else math.nan


def _known(depth: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rendered and true z at the pixels of known depth, float64."""
    if depth.shape != truth.shape:
        raise ValueError(f"depth: expected the truth's shape {truth.shape}, found {depth.shape}")
    there = truth > 0
    return depth[there].astype(np.float64), truth[there].astype(np.float64)
