"""Views shifted onto each other and averaged: a photograph by a lens as wide as their window.

A point of disparity d, in pixels per unit of the grid, is at x + d u in the view at u. Shifted back by f u and averaged
over |u| <= rho, points with d = f stay sharp and others spread over a disc of radius rho |d - f|, with correct
occlusion (Ng et al., Light Field Photography with a Hand-held Plenoptic Camera, 2005).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from dofbench.core.lens import GAMMA
from dofbench.optics.tone import decode

LOBES = 3  # of the interpolation: how many pixels around a place count


def averaged(views: Iterable[tuple[np.ndarray, tuple[float, float], float]], gamma: float = GAMMA) -> np.ndarray:
    """Weighted mean of shifted views in linear light, (H, W, 3) float64.

    views: (image (H, W, 3) float32, encoded; (down, right) shift as in `shifted`; weight).
    """
    total, weights = np.float64(0), 0.0
    for image, by, weight in views:
        total = total + weight * decode(np.clip(shifted(image, by), 0, 1).astype(np.float64), gamma)
        weights += weight
    return np.asarray(total / weights)


def shifted(image: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    """The image, (H, W[, C]) float32, sampled `by` (down, right) pixels from every pixel; borders are repeated."""
    import cv2

    # OpenCV's warping rounds positions to 1/32 pixel, which is coarser than a step of the sweep.
    down, right = (_lanczos(shift) for shift in by)
    return np.asarray(cv2.sepFilter2D(image, -1, right, down, borderType=cv2.BORDER_REPLICATE))


def _lanczos(shift: float) -> np.ndarray:
    """Weights of the pixels around x for the value at x + shift: Lanczos, 3 lobes."""
    reach = math.ceil(abs(shift)) + LOBES
    distance = np.arange(-reach, reach + 1) - shift
    weights = np.where(np.abs(distance) < LOBES, np.sinc(distance) * np.sinc(distance / LOBES), 0.0)
    return weights / weights.sum()
