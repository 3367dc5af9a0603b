"""Peak signal-to-noise ratio."""

from __future__ import annotations

import math

import numpy as np

from dofbench.metrics._images import checked


def psnr(prediction: np.ndarray, truth: np.ndarray) -> float:
    """-10 log10 of the mean squared difference over pixels and channels, dB; infinite for equal images.

    prediction, truth: (H, W, 3), encoded, [0, 1]. Raises ValueError for shapes that don't fit.
    """
    prediction, truth = checked(prediction, truth)
    error = float(np.mean(np.square(prediction - truth)))
    return math.inf if error == 0 else -10.0 * math.log10(error)
