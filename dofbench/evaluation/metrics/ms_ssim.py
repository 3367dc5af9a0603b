"""Multi-scale structural similarity.

Source: Wang, Simoncelli, Bovik, "Multi-scale structural similarity for image quality assessment",
Asilomar 2003, equation 7 and section 3.2.
"""

from __future__ import annotations

import numpy as np

from dofbench.core.similarity import WINDOW, centre, checked, similarity_factors, unmasked

_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # section 3.2, finest scale first


def scale_count(height: int, width: int) -> int:
    """How many of the five scales an image has: those on which the window still fits."""
    side, count = min(height, width), 0
    while count < len(_WEIGHTS) and side >= WINDOW:
        side, count = side // 2, count + 1
    return count


def ms_ssim(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Contrast-structure at every scale and luminance at the coarsest, weighted by powers; 0 ... 1.

    Scales are halved by 2 x 2 means; an odd last row or column is dropped. Images under 176
    pixels on the shorter side have fewer scales, and the weights left are scaled to sum to one.
    Each channel has its own value and the result is their mean. The powers are not defined for a
    negative mean, which counts as 0, the worst.
    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`; at coarser scales a pixel counts by its
    valid share. Raises ValueError for shapes that don't fit or sides under 11 pixels.
    """
    prediction, truth = checked(*unmasked(prediction, truth, mask), smallest=WINDOW)
    share = None if mask is None else mask.astype(np.float64)[..., None]
    scales = scale_count(*prediction.shape[:2])
    weights = np.array(_WEIGHTS[:scales]) / sum(_WEIGHTS[:scales])
    channels = np.ones(3)
    for scale, weight in enumerate(weights):
        if scale:
            prediction, truth = _halved(prediction), _halved(truth)
            share = None if share is None else _halved(share)
        luminance, factor = similarity_factors(prediction, truth)
        if scale == scales - 1:
            factor = luminance * factor
        mean = factor.mean(axis=(0, 1)) if share is None else _weighted(factor, centre(share, factor))
        channels *= np.where(mean < 0, 0.0, mean) ** weight
    return float(channels.mean())


def _weighted(factor: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(3,) means of (H, W, 3), weighted by (H, W, 1); plain means where all weights are 0."""
    total = share.sum()
    return (factor * share).sum(axis=(0, 1)) / total if total > 0 else factor.mean(axis=(0, 1))


def _halved(image: np.ndarray) -> np.ndarray:
    even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
    return 0.25 * (even[0::2, 0::2] + even[0::2, 1::2] + even[1::2, 0::2] + even[1::2, 1::2])
