"""The two factors of structural similarity, pixel by pixel, in float64; what SSIM and MS-SSIM share.

Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to
structural similarity", IEEE TIP 2004, equations 6 to 13.
"""

from __future__ import annotations

import numpy as np

WINDOW = 11  # pixels
_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2  # (K1 L)^2, (K2 L)^2 for images in [0, 1]


def similarity_factors(prediction: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(luminance, contrast times structure), each (H - 10, W - 10, C): where the window lies inside.

    prediction, truth: (H, W, C) float64, at least `WINDOW` pixels each way.
    """
    mean_p, mean_t = _blur(prediction), _blur(truth)
    # Taken from the mid-grey, the squares lose fewer digits; variances don't change.
    p, t = prediction - 0.5, truth - 0.5
    shifted_p, shifted_t = mean_p - 0.5, mean_t - 0.5
    variances = _blur(p * p + t * t) - shifted_p * shifted_p - shifted_t * shifted_t
    covariance = _blur(p * t) - shifted_p * shifted_t
    luminance = (2 * mean_p * mean_t + _C1) / (mean_p * mean_p + mean_t * mean_t + _C1)
    return luminance, (2 * covariance + _C2) / (variances + _C2)


def _blur(image: np.ndarray) -> np.ndarray:
    from scipy.ndimage import correlate1d

    radius = WINDOW // 2
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / _SIGMA) ** 2)
    weights /= weights.sum()
    rows = correlate1d(image, weights, axis=0)[radius:-radius]
    return correlate1d(rows, weights, axis=1)[:, radius:-radius]
