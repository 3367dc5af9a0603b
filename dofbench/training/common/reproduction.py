"""How well a training reproduces its own photographs: the least that must be so before a lens is asked for.

A rendering that is blurrier than the photograph has nothing left that a lens could explain: what separates the two
isn't defocus but a scene that wasn't found, such as a background without starting points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dofbench.core.contracts import TrainingView

_FINE, _COARSE = 1.0, 4.0  # px, standard deviations of the Gaussians whose difference is the band


@dataclass(frozen=True)
class Reproduction:
    """psnr: of the training photographs, mean over the views, dB. detail: energy of the renderings over that of the
    photographs in the band between 1 and 4 px, median over the views, dB; negative where renderings are blurrier."""

    psnr: float
    detail: float


def reproduction(views: Sequence[TrainingView], render: Callable[[int], np.ndarray]) -> Reproduction:
    """Compare every training photograph with its rendering. render: (H, W, 3) encoded, of a view by its number."""
    psnr, detail = [], []
    for number, view in enumerate(views):
        rendered, image = np.clip(render(number), 0.0, 1.0), view.image
        used = np.ones(rendered.shape[:2], bool) if view.mask is None else view.mask
        if not used.any():
            continue
        error = float(np.mean(np.square(rendered.astype(float) - image)[used]))
        psnr.append(-10 * math.log10(max(error, (0.1 / 255) ** 2)))
        detail.append(10 * math.log10(_energy(rendered, used) / _energy(image, used)))
    return Reproduction(float(np.mean(psnr)), float(np.median(detail)))


def _energy(image: np.ndarray, used: np.ndarray) -> float:
    """Mean square of the band over the pixels of `used`; at least that of rounding to 8 bit."""
    from scipy.ndimage import gaussian_filter

    grey = image.mean(axis=2, dtype=float)
    band = gaussian_filter(grey, _FINE) - gaussian_filter(grey, _COARSE)
    return max(float(np.mean(np.square(band)[used])), 1 / (12 * 255**2))
