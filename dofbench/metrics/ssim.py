"""Structural similarity as a score; the training loss is the kernel of that name."""

from __future__ import annotations

import numpy as np

from dofbench.metrics._images import checked
from dofbench.metrics._similarity import WINDOW, similarity_factors
from dofbench.metrics.masked_scores import unmasked, valid_mean


def ssim(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean structural similarity over pixels and channels, -1 ... 1.

    Gaussian window of 11 pixels, sigma 1.5, data range 1, population covariance, border cropped:
    scikit-image's `structural_similarity(gaussian_weights=True, use_sample_covariance=False)`.
    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`. Raises ValueError for shapes
    that don't fit or sides under 11 pixels.
    """
    return valid_mean(ssim_map(*unmasked(prediction, truth, mask)), mask)


def ssim_map(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H - 10, W - 10, 3): what `ssim` is the mean of, pixel (5, 5) of the images first; arguments as there."""
    luminance, structure = similarity_factors(*checked(prediction, truth, smallest=WINDOW))
    return luminance * structure
