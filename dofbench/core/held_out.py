"""Held-out pixels: tiles of training views that are kept for scoring.

A tile is so wide that most of its pixels are out of reach of the loss's window around the pixels used, and so small
that other views, and the light that a lens spreads, still determine its content.
"""

from __future__ import annotations

import math

import numpy as np

from dofbench.core.similarity import ssim_map

TILE = 16  # px, at full size
_WINDOW_REACH = 5  # px, half width of SSIM's window


def held_out_tiles(height: int, width: int, share: float, seed: int, view: int) -> np.ndarray:
    """(height, width) bool: the held-out pixels of view number `view`: a random `share` of its tiles, at least one and
    never all. They depend on seed and view alone."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    count = rows * columns
    drawn = min(max(1, round(share * count)), count - 1)
    tiles = np.zeros(count, dtype=bool)
    tiles[np.random.default_rng([seed, view]).permutation(count)[:drawn]] = True
    return np.kron(tiles.reshape(rows, columns), np.ones((TILE, TILE), dtype=bool))[:height, :width]


def tile_scores(prediction: np.ndarray, image: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """(PSNR in dB, SSIM) over the pixels of `mask`, (H, W) bool; images (H, W, 3), encoded, [0, 1].

    An error below a tenth of an 8-bit level counts as a tenth of a level, so that no view has an infinite PSNR.
    """
    from scipy.ndimage import binary_erosion

    if not mask.any():
        return math.nan, math.nan
    error = float(np.mean(np.square(prediction.astype(float) - image)[mask]))
    psnr = -10 * math.log10(max(error, (0.1 / 255) ** 2))
    side = 2 * _WINDOW_REACH + 1
    whole = binary_erosion(mask, np.ones((side, side)))  # outside the image counts as not held out
    if not whole.any():
        return psnr, math.nan
    inner = whole[_WINDOW_REACH:-_WINDOW_REACH, _WINDOW_REACH:-_WINDOW_REACH]
    return psnr, float(ssim_map(prediction, image)[inner].mean())
