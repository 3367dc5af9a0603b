"""Image metrics from other papers: MS-SSIM, GMSD, CIEDE2000, and SSIM as DoF-Gaussian's script measures it.

Every function takes a prediction and its truth, (H, W, 3), encoded, [0, 1], and a mask as for `unmasked`. It raises
ValueError for shapes that don't fit or sides that are too short.
"""

from __future__ import annotations

import importlib
import sys
from functools import partial
from typing import Any

import numpy as np

from dofbench.core.similarity import (
    WINDOW,
    centre,
    checked,
    similarity_factors,
    uniform_mean,
    unmasked,
    valid_mean,
)

_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # of MS-SSIM, section 3.2, finest scale first
_UNIFORM = 7  # pixels, window of SSIM in DoF-Gaussian's script
_LUMA = np.array([0.299, 0.587, 0.114])  # Rec. 601, as in GMSD's program
_C = 170.0  # of GMSD, section III-C, for values of 0 ... 255
_SMALLEST = 3  # pixels for GMSD; leaves 2 x 2 values whose deviation can be taken


def scale_count(height: int, width: int) -> int:
    """How many of the five scales of MS-SSIM fit an image."""
    side, count = min(height, width), 0
    while count < len(_WEIGHTS) and side >= WINDOW:
        side, count = side // 2, count + 1
    return count


def ms_ssim(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Multi-scale structural similarity, 0 ... 1: contrast-structure at every scale, luminance at the coarsest.

    Source: Wang, Simoncelli, Bovik, "Multi-scale structural similarity for image quality assessment", Asilomar 2003,
    equation 7 and section 3.2. Scales are halved by 2 x 2 means; an odd last row or column is dropped. Images under 176
    pixels have fewer scales, with weights normalised. The mean over channels; a negative mean counts as 0. At coarser
    scales a pixel counts by its valid share.
    """
    prediction, truth = checked(*unmasked(prediction, truth, mask), smallest=WINDOW)
    share = None if mask is None else mask.astype(np.float64)[..., None]
    scales = scale_count(*prediction.shape[:2])
    weights = np.array(_WEIGHTS[:scales]) / sum(_WEIGHTS[:scales])
    channels = np.ones(3)
    for scale, weight in enumerate(weights):
        if scale:
            prediction, truth = _even_halved(prediction), _even_halved(truth)
            share = None if share is None else _even_halved(share)
        luminance, factor = similarity_factors(prediction, truth)
        if scale == scales - 1:
            factor = luminance * factor
        mean = factor.mean(axis=(0, 1)) if share is None else _weighted(factor, centre(share, factor))
        channels *= np.where(mean < 0, 0.0, mean) ** weight
    return float(channels.mean())


def _weighted(factor: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(3,) means of (H, W, 3), weighted by (H, W, 1); plain means where all weights are 0."""
    total = share.sum()
    return (factor * share).sum(axis=(0, 1)) / total if total > 0 else factor.mean(axis=(0, 1))


def _even_halved(image: np.ndarray) -> np.ndarray:
    return _cells(image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2])


def _cells(even: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels."""
    return 0.25 * (even[0::2, 0::2] + even[0::2, 1::2] + even[1::2, 0::2] + even[1::2, 1::2])


def gmsd(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Gradient magnitude similarity deviation on halved luma; 0 is best.

    Source: Xue, Zhang, Mou, Bovik, "Gradient magnitude similarity deviation", IEEE TIP 2014, equations 1 to 6 and
    section III-C; zeros beyond the border and the sample deviation as in the authors' program. A halved pixel counts if
    any of its four is valid.
    """
    images = checked(*unmasked(prediction, truth, mask), smallest=_SMALLEST)
    a, b = (_gradient(_padded_halved(255.0 * (image @ _LUMA))) for image in images)
    similarity = (2 * a * b + _C) / (a * a + b * b + _C)
    if mask is not None and np.count_nonzero(kept := _padded_halved(mask.astype(np.float64)) > 0) > 1:
        similarity = similarity[kept]
    return float(np.std(similarity, ddof=1))


def _padded_halved(luma: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels; an odd last row or column is averaged with zeros."""
    return _cells(np.pad(luma, ((0, luma.shape[0] % 2), (0, luma.shape[1] % 2))))


def _gradient(luma: np.ndarray) -> np.ndarray:
    """Magnitude of the Prewitt gradient, equations 1 to 3."""
    padded = np.pad(luma, 1)
    across = padded[:, 2:] - padded[:, :-2]
    down = padded[2:] - padded[:-2]
    dx = (across[:-2] + across[1:-1] + across[2:]) / 3
    dy = (down[:, :-2] + down[:, 1:-1] + down[:, 2:]) / 3
    return np.hypot(dx, dy)


def delta_e(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean CIEDE2000 over the pixels; 0 is best, about 1 is just noticeable, 100 is black on white.

    Source: Sharma, Wu, Dalal, "The CIEDE2000 color-difference formula", Color Research and Application 2005, by
    colour-science. Pixels are taken as sRGB (IEC 61966-2-1), D65, 2 degree observer, whatever the dataset's gamma.
    """
    colour = _colour_science()

    one, other = (colour.XYZ_to_Lab(colour.sRGB_to_XYZ(image)) for image in checked(*unmasked(prediction, truth, mask)))
    return valid_mean(colour.difference.delta_E_CIE2000(one, other), mask)


def ssim_uniform7(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean SSIM over pixels and channels, -1 ... 1, by a uniform window of 7 pixels, as DoF-Gaussian measures it.

    Its released script (metric.py, from Deblur-NeRF) calls scikit-image's `structural_similarity` with its defaults,
    uniform window and sample covariance, on images scaled to -1 ... 1: the luminance term is relative to mid-grey.
    """
    luminance, structure = similarity_factors(
        *checked(*unmasked(prediction, truth, mask), smallest=_UNIFORM),
        partial(uniform_mean, window=_UNIFORM),
        black=0.5,
        correction=_UNIFORM**2 / (_UNIFORM**2 - 1),
    )
    return valid_mean(luminance * structure, mask)


def _colour_science() -> Any:
    """Import colour-science without OpenImageIO, which it would use for files alone and hold until the program ends:
    then OpenImageIO's binding prints a page about leaks."""
    if "colour" not in sys.modules:
        name = "OpenImageIO"
        loaded = sys.modules.pop(name, None)
        sys.modules[name] = None  # type: ignore[assignment]  # as Python marks a module that can't be imported
        try:
            importlib.import_module("colour")
        finally:
            del sys.modules[name]
            if loaded is not None:
                sys.modules[name] = loaded
    return sys.modules["colour"]
