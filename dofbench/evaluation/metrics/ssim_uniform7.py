"""Structural similarity as the authors of DoF-Gaussian measure it, for comparison with their figures."""

from __future__ import annotations

from functools import partial

import numpy as np

from dofbench.core.similarity import checked, similarity_factors, uniform_mean, unmasked, valid_mean

_WINDOW = 7  # pixels
_IN_WINDOW = _WINDOW * _WINDOW


def ssim_uniform7(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean structural similarity over pixels and channels, -1 ... 1, by a uniform window of 7 pixels.

    The released script (metric.py of github.com/leoShen917/DoF-Gaussian, which has it from Deblur-NeRF) calls
    scikit-image's `structural_similarity` with its defaults, a uniform window of 7 and sample covariance, on images
    that are stretched to -1 ... 1, of data range 2: so the luminance term measures brightness from mid-grey.
    `ssim` has a Gaussian window of 11, population covariance, and black at 0.
    prediction, truth: (H, W, 3), encoded, [0, 1]. mask: as for `unmasked`. Raises ValueError for shapes that don't fit
    or sides under 7 pixels.
    """
    luminance, structure = similarity_factors(
        *checked(*unmasked(prediction, truth, mask), smallest=_WINDOW),
        partial(uniform_mean, window=_WINDOW),
        black=0.5,
        correction=_IN_WINDOW / (_IN_WINDOW - 1),
    )
    return valid_mean(luminance * structure, mask)
