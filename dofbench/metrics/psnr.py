"""Peak signal-to-noise ratio."""

from __future__ import annotations

import math

import numpy as np

from dofbench.metrics._images import checked
from dofbench.metrics.masked_scores import unmasked, valid_mean


def psnr(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """-10 log10 of the mean squared difference over pixels and channels, dB; infinite for equal images.

    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`. Raises ValueError for shapes that don't fit.
    """
    prediction, truth = checked(*unmasked(prediction, truth, mask))
    error = valid_mean(np.square(prediction - truth), mask)
    return math.inf if error == 0 else -10.0 * math.log10(error)
