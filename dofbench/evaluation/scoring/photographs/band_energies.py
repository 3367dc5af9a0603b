"""Is a prediction as blurred as its photograph? Log ratios of local energies in bands of frequencies.

Blur takes energy from fine bands: by a Gaussian of variance v it leaves exp(-v w^2) of the energy at the angular
frequency w. Phase doesn't matter, so that a displaced texture keeps its energies where a difference of pixels grows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dofbench.core.similarity import checked, unmasked
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles
from dofbench.optics.blur_width import LUMA

BANDS = (0.5, 1.0, 2.0, 4.0)  # px: each is the difference of two Gaussians of this sigma and twice this sigma
WINDOW = 1 / 3  # sigma of the Gaussian window that energies are averaged over, of a tile's side
ROUNDING = 1 / (255 * 12**0.5)  # standard deviation of 8-bit rounding
FLOOR = 10 * ROUNDING  # standard deviation of the white noise whose energy is added to both, and to local means


@dataclass(frozen=True, eq=False)
class BandRatios:
    """Energy of the prediction over the photograph's, dB. ratios: (bands, P), at the P scored pixels where the
    photograph has texture, its energy in one band or more being above the floor's."""

    ratios: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """(bands,): mean magnitude, dB; 0 is best. NaN without texture."""
        return _mean(np.abs(self.ratios))

    @property
    def excess(self) -> np.ndarray:
        """(bands,): mean, dB; negative where the prediction is more blurred. NaN without texture."""
        return _mean(self.ratios)


def band_ratios(prediction: np.ndarray, photograph: np.ndarray, tiles: Tiles) -> BandRatios:
    """Log ratios of local band energies at the scored pixels.

    prediction, photograph: (H, W, 3), encoded, [0, 1]. Energies are of luma, over scored pixels alone, and relative to
    the squared local mean, so that exposure has no influence. Raises ValueError for shapes that don't fit.
    """
    images = checked(*unmasked(prediction, photograph, tiles.mask))
    (energy, mean), (true_energy, true_mean) = (_energies(image @ LUMA, tiles) for image in images)
    floor = np.array([FLOOR**2 * _noise_gain(band) for band in BANDS])[:, None]
    alike = energy * ((true_mean + FLOOR) / (mean + FLOOR)) ** 2
    textured = (true_energy > floor).any(axis=0)
    return BandRatios((10 * np.log10((alike + floor) / (true_energy + floor)))[:, textured])


def band_energy(image: np.ndarray, band: float, tiles: Tiles) -> np.ndarray:
    """(H, W): the local energy of one of `BANDS` in the luma of an image, (H, W, 3), averaged over scored pixels; zero
    where there is none near."""
    from scipy.ndimage import gaussian_filter

    sigma, scored = WINDOW * tiles.side, tiles.scored.astype(np.float64)
    weight = gaussian_filter(scored, sigma)
    total = gaussian_filter(_band(image @ LUMA, band) ** 2 * scored, sigma)
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 1e-6)


def _energies(luma: np.ndarray, tiles: Tiles) -> tuple[np.ndarray, np.ndarray]:
    """At the scored pixels: the energy of each band, (bands, P), and the mean, (P,)."""
    from scipy.ndimage import gaussian_filter

    sigma, scored = WINDOW * tiles.side, tiles.scored
    weight = gaussian_filter(scored.astype(np.float64), sigma)[scored]

    def windowed(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values * scored, sigma)[scored] / weight

    return np.array([windowed(_band(luma, band) ** 2) for band in BANDS]), windowed(luma)


def _band(luma: np.ndarray, sigma: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(luma, sigma) - gaussian_filter(luma, 2 * sigma)


@lru_cache
def _noise_gain(sigma: float) -> float:
    """The energy of a band of white noise of variance 1."""
    size = 2 * int(8 * sigma + 1) + 1  # as far as the wider Gaussian reaches
    impulse = np.zeros((size, size))
    impulse[size // 2, size // 2] = 1
    return float(np.sum(_band(impulse, sigma) ** 2))


def _mean(values: np.ndarray) -> np.ndarray:
    return values.mean(axis=1) if values.size else np.full(len(values), np.nan)
