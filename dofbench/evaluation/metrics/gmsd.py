"""Gradient magnitude similarity deviation.

Source: Xue, Zhang, Mou, Bovik, "Gradient magnitude similarity deviation: a highly efficient
perceptual image quality index", IEEE TIP 2014, equations 1 to 6 and section III-C. Choices that
the paper leaves open are those of its authors' program: zeros beyond the border, and the sample's
standard deviation.
"""

from __future__ import annotations

import numpy as np

from dofbench.core.similarity import checked, unmasked

_LUMA = np.array([0.299, 0.587, 0.114])  # Rec. 601, what the authors' images were converted by
_C = 170.0  # section III-C, for values of 0 ... 255
_SMALLEST = 3  # pixels; leaves 2 x 2 values whose deviation can be taken


def gmsd(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Deviation of the gradient similarity over the pixels of the halved luma images; 0 is best.

    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`; a halved pixel counts if any of its four
    is valid. Raises ValueError for shapes that don't fit or sides under 3 pixels.
    """
    images = checked(*unmasked(prediction, truth, mask), smallest=_SMALLEST)
    a, b = (_gradient(_halved(255.0 * (image @ _LUMA))) for image in images)
    similarity = (2 * a * b + _C) / (a * a + b * b + _C)
    if mask is not None and np.count_nonzero(kept := _halved(mask.astype(np.float64)) > 0) > 1:
        similarity = similarity[kept]
    return float(np.std(similarity, ddof=1))


def _halved(luma: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels; an odd last row or column is averaged with zeros."""
    padded = np.pad(luma, ((0, luma.shape[0] % 2), (0, luma.shape[1] % 2)))
    return 0.25 * (padded[0::2, 0::2] + padded[0::2, 1::2] + padded[1::2, 0::2] + padded[1::2, 1::2])


def _gradient(luma: np.ndarray) -> np.ndarray:
    """Magnitude of the Prewitt gradient, equations 1 to 3."""
    padded = np.pad(luma, 1)
    across = padded[:, 2:] - padded[:, :-2]
    down = padded[2:] - padded[:-2]
    dx = (across[:-2] + across[1:-1] + across[2:]) / 3
    dy = (down[:, :-2] + down[:, 1:-1] + down[:, 2:]) / 3
    return np.hypot(dx, dy)
