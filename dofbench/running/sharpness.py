"""How blurred photographs are, told from the photographs.

A photograph with shallow depth of field has depths at which nothing is sharp. So the sharpest detail is looked for at
each depth that the sparse points have: how much a second, known blur takes from the gradients around a point tells how
blurred they were before (Zhuo and Sim, 2011, who compare single edges; here it is energies in a window). Texture that
is smooth by itself looks blurred too, which is why only the sharpest of many points at one depth counts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dofbench.scenes.visibility import Seen

LUMA = np.array([0.299, 0.587, 0.114])
SECOND_BLUR = 1.0  # px, standard deviation
WINDOW = 9  # px
DEPTHS = 6  # bins of disparity
LEAST_POINTS = 15  # in a bin of a view
SHARPEST = 0.1  # quantile over a bin's points that stands for its sharpest detail
CONTRAST = 0.01  # gradient, per px of a range of 1, below which there is no detail to judge by
ABOVE_NOISE = 4.0  # times the noise's own energy that detail must have
OWN_SOFTNESS = 0.7  # px: lens, sensor and scaling blur a photograph in focus by this much at most
MOST = 8.0  # px: a wider blur can't be measured, since the second one hardly changes it
WIDEST = 0.75  # quantile over the views: some may see only things that are in focus


def largest_blur(images: Sequence[np.ndarray], seen: Sequence[Seen]) -> float | None:
    """Radius in pixels of the largest circle of confusion that the photographs show; None where they don't tell.

    images: (H, W, 3) encoded. Good to about half a pixel: photographs in focus give up to 0.6.
    """
    disparity = np.concatenate([1 / view.depth for view in seen])
    if not len(disparity):
        return None
    near, far = np.quantile(disparity, (0.99, 0.01))
    extent = max(near - far, np.finfo(float).tiny)
    sharpest = np.full((len(images), DEPTHS), np.nan)
    for row, image, view in zip(sharpest, images, seen, strict=True):
        deviation = blur_deviation(np.asarray(image, np.float64) @ LUMA)
        found = deviation[view.xy[:, 1].astype(int), view.xy[:, 0].astype(int)]
        depth = np.clip(((1 / view.depth - far) / extent * DEPTHS).astype(int), 0, DEPTHS - 1)
        for k in range(DEPTHS):
            values = found[(depth == k) & np.isfinite(found)]
            if len(values) >= LEAST_POINTS:
                row[k] = np.quantile(values, SHARPEST)
    told = sharpest[np.isfinite(sharpest).any(axis=1)]
    if not len(told):
        return None
    own = min(np.nanquantile(told, SHARPEST), OWN_SOFTNESS)
    widest = np.nanmax(told, axis=1)
    # A disc of radius R has the standard deviation R / 2 along an axis, and variances add up.
    return float(np.quantile(2 * np.sqrt(np.maximum(widest**2 - own**2, 0)), WIDEST))


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
