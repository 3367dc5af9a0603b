"""The blur around each pixel of an image, by its gradients before and after a second, known blur."""

from __future__ import annotations

import numpy as np

LUMA = np.array([0.299, 0.587, 0.114])
SECOND_BLUR = 1.0  # px, standard deviation
WINDOW = 9  # px
CONTRAST = 0.01  # least gradient of detail, per px of a range of 1
ABOVE_NOISE = 4.0  # least energy of detail, times the noise's energy
MOST = 8.0  # px: a wider blur can't be measured, since the second blur hardly changes it


def blur_deviation(luma: np.ndarray) -> np.ndarray:
    """(H, W) standard deviation, pixels, of the blur around each pixel of (H, W) luma; NaN where there is no detail.

    Of an edge blurred by a Gaussian of deviation s, the squared gradients sum up to something in proportion to
    1 / s. So the ratio q of the sums before and after a second blur of deviation t gives s = t / sqrt(q ** 2 - 1).
    """
    from scipy.ndimage import gaussian_filter, uniform_filter

    def energy(image: np.ndarray) -> np.ndarray:
        down, along = np.gradient(image)
        return down**2 + along**2

    impulse = np.zeros((33, 33))
    impulse[16, 16] = 1.0
    variance = noise_deviation(luma) ** 2
    before = uniform_filter(energy(luma), WINDOW) - variance * energy(impulse).sum()
    left = variance * energy(gaussian_filter(impulse, SECOND_BLUR)).sum()
    after = uniform_filter(energy(gaussian_filter(luma, SECOND_BLUR)), WINDOW) - left
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = before / after
        deviation = np.where(ratio > 1, SECOND_BLUR / np.sqrt(ratio**2 - 1), MOST)
    return np.where(after > max(CONTRAST**2, ABOVE_NOISE * left), np.minimum(deviation, MOST), np.nan)


def noise_deviation(luma: np.ndarray) -> float:
    """Standard deviation of white noise, by the median |second difference along both axes| (after Immerkaer, 1996)."""
    rows = luma[2:] - 2 * luma[1:-1] + luma[:-2]
    both = rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2]
    return float(np.median(np.abs(both)) / 0.6745 / 6) if both.size else 0.0
