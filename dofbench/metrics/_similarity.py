"""The two factors of structural similarity, pixel by pixel, in float64; what all forms of SSIM share.

Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to
structural similarity", IEEE TIP 2004, equations 6 to 13.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

WINDOW = 11  # pixels
_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2  # (K1 L)^2, (K2 L)^2 for images in [0, 1]


def gaussian_mean(image: np.ndarray) -> np.ndarray:
    """(H, W, C) -> (H - 10, W - 10, C): means by a Gaussian window of 11 pixels, sigma 1.5."""
    radius = WINDOW // 2
    weights = np.exp(-0.5 * (np.arange(-radius, radius + 1) / _SIGMA) ** 2)
    return _windowed(image, weights / weights.sum())


def uniform_mean(image: np.ndarray, window: int) -> np.ndarray:
    """(H, W, C) -> (H - window + 1, W - window + 1, C): means over squares of `window`, an odd number of pixels."""
    return _windowed(image, np.full(window, 1 / window))


def similarity_factors(
    prediction: np.ndarray,
    truth: np.ndarray,
    mean: Callable[[np.ndarray], np.ndarray] = gaussian_mean,
    *,
    black: float = 0.0,
    correction: float = 1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """(luminance, contrast times structure), each as large as `mean` makes an image: where its window lies inside.

    prediction, truth: (H, W, C) float64, at least as large as the window. mean: the window. black: the value that the
    luminance is measured from. correction: factor of variances and covariance, n / (n - 1) for those of a sample of n.
    """
    mean_p, mean_t = mean(prediction), mean(truth)
    # Taken from the mid-grey, the squares lose fewer digits; variances don't change.
    p, t = prediction - 0.5, truth - 0.5
    shifted_p, shifted_t = mean_p - 0.5, mean_t - 0.5
    variances = correction * (mean(p * p + t * t) - shifted_p * shifted_p - shifted_t * shifted_t)
    covariance = correction * (mean(p * t) - shifted_p * shifted_t)
    light_p, light_t = mean_p - black, mean_t - black
    luminance = (2 * light_p * light_t + _C1) / (light_p * light_p + light_t * light_t + _C1)
    return luminance, (2 * covariance + _C2) / (variances + _C2)


def _windowed(image: np.ndarray, weights: np.ndarray) -> np.ndarray:
    from scipy.ndimage import correlate1d

    radius = len(weights) // 2
    rows = correlate1d(image, weights, axis=0)[radius:-radius]
    return correlate1d(rows, weights, axis=1)[:, radius:-radius]
