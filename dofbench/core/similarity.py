"""Comparing two images: PSNR, SSIM and what other scores share.

Images with a mask are scored at their valid pixels alone. Masked pixels are replaced in the truth by their nearest
valid ones and in the prediction by the truth, so nothing under a mask has an influence. An error map is then averaged
over the valid pixels.

Source of SSIM: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to structural
similarity", IEEE TIP 2004, equations 6 to 13.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dofbench.core.images import check_floats
from dofbench.core.masks import filled

WINDOW = 11  # pixels
_SIGMA = 1.5
_C1, _C2 = 0.01**2, 0.03**2  # (K1 L)^2, (K2 L)^2 for images in [0, 1]


def checked(prediction: np.ndarray, truth: np.ndarray, smallest: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Both images as float64 (H, W, 3).

    Raises ValueError unless both are floating, of one shape (H, W, 3), and `smallest` pixels or
    more on the shorter side.
    """
    for name, image in (("prediction", prediction), ("truth", truth)):
        if image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"{name}: expected an image of shape (H, W, 3), found {image.shape}")
        check_floats(name, image)
    if prediction.shape != truth.shape:
        raise ValueError(f"prediction: expected the truth's shape {truth.shape}, found {prediction.shape}")
    if min(prediction.shape[:2]) < smallest:
        raise ValueError(f"prediction: expected at least {smallest} x {smallest} pixels, found {prediction.shape}")
    return prediction.astype(np.float64), truth.astype(np.float64)


def unmasked(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Both images with their masked pixels replaced; mask: (H, W) bool, True where valid, or None.

    Raises ValueError for a mask of another size, or without a valid pixel.
    """
    if mask is None:
        return prediction, truth
    if mask.shape != truth.shape[:2] or not mask.any():
        raise ValueError(f"mask: expected valid pixels of shape {truth.shape[:2]}, found {mask.shape}, {mask.sum()}")
    whole = filled(truth, mask)
    return (np.where(mask[..., None], prediction, whole) if prediction.shape == truth.shape else prediction), whole


def valid_mean(values: np.ndarray, mask: np.ndarray | None) -> float:
    """Mean of an error map (H, W, ...) over the valid pixels; of a map without its border, where windows lie inside.

    Where no window is centred on a valid pixel, all windows count.
    """
    if mask is None:
        return float(np.mean(values))
    kept = centre(mask, values)
    return float(np.mean(values[kept])) if kept.any() else float(np.mean(values))


def centre(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The middle of (H, W) values, as large as `like` is."""
    top, left = ((size - inner) // 2 for size, inner in zip(values.shape[:2], like.shape[:2], strict=True))
    return values[top : top + like.shape[0], left : left + like.shape[1]]


def psnr(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """-10 log10 of the mean squared difference over pixels and channels, dB; infinite for equal images.

    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`. Raises ValueError for shapes that don't fit.
    """
    prediction, truth = checked(*unmasked(prediction, truth, mask))
    error = valid_mean(np.square(prediction - truth), mask)
    return math.inf if error == 0 else -10.0 * math.log10(error)


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
