"""Pixels held back from training: tiles of the training photographs that no colour loss uses, kept for scoring.

Which setting explains the photographs best is decided on pixels that weren't used in training. A tile is so wide that
most of its pixels are out of reach of the loss's window around the pixels used, and so small that other views, and the
light that a lens spreads, still determine its content. Sparse points, depth priors and the Gaussians' initial colours
come from the whole photographs, so only trainings with the same of these can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.core.masks import touched
from dofbench.core.similarity import ssim_map

TILE = 16  # px, in the photograph at full size
_WINDOW_REACH = 5  # px, half width of SSIM's window


@dataclass(frozen=True)
class HeldBackScores:
    """Scores on held-back pixels alone; means over the views. views: name -> (PSNR in dB, SSIM).

    ssim: over the pixels whose window lies in held-back tiles; NaN for a view without such pixels, which the mean
    leaves out.
    """

    psnr: float
    ssim: float
    views: Mapping[str, tuple[float, float]]


def held_back_tiles(height: int, width: int, share: float, seed: int, view: int) -> np.ndarray:
    """(height, width) bool: the pixels of view number `view` that are held back.

    A random choice of `share` of its tiles, at least one and never all of them. The choice depends on seed and view
    alone.
    """
    rows, columns = -(-height // TILE), -(-width // TILE)
    count = rows * columns
    drawn = min(max(1, round(share * count)), count - 1)
    tiles = np.zeros(count, dtype=bool)
    tiles[np.random.default_rng([seed, view]).permutation(count)[:drawn]] = True
    return np.kron(tiles.reshape(rows, columns), np.ones((TILE, TILE), dtype=bool))[:height, :width]


def held_back_mask(
    height: int, width: int, shown: tuple[int, int], share: float, seed: int, view: int
) -> Tensor | None:
    """`held_back_tiles` of a photograph (height, width), at the size (height, width) `shown`; None for a share of 0."""
    if share <= 0:
        return None
    tiles = held_back_tiles(height, width, share, seed, view)
    return torch.from_numpy(np.ascontiguousarray(touched(tiles, shown[1], shown[0])))


def held_back_scores(
    photographs: Mapping[str, np.ndarray],
    render: Callable[[int], np.ndarray],
    share: float,
    seed: int,
    masks: Sequence[np.ndarray | None] | None = None,
) -> HeldBackScores:
    """Score renderings of the training views on the pixels that were held back.

    photographs: name -> (H, W, 3) encoded, in the training set's order. render: the rendering of a view by its
    number, (H, W, 3) encoded, with its learned lens and colour (`Trainer.photograph`). share, seed: as trained with.
    masks: (H, W) bool of each view, False for pixels that aren't scored, or None. Without a valid held-back pixel a
    view has the scores NaN, and doesn't count. Raises ValueError for a share of 0.
    """
    if share <= 0:
        raise ValueError(f"held-back scores: expected a share above 0, found {share}")
    views = {}
    for number, (name, photograph) in enumerate(photographs.items()):
        height, width = photograph.shape[:2]
        tiles = held_back_tiles(height, width, share, seed, number)
        if masks is not None and (valid := masks[number]) is not None:
            tiles &= valid
        views[name] = tile_scores(np.clip(render(number), 0, 1), photograph, tiles)
    psnr, ssim = np.array(list(views.values())).T
    if np.isnan(psnr).any() and not np.isnan(psnr).all():
        return HeldBackScores(float(np.nanmean(psnr)), _mean(ssim), views)
    return HeldBackScores(float(psnr.mean()), _mean(ssim), views)


def _mean(ssim: np.ndarray) -> float:
    return float(np.nanmean(ssim)) if np.isfinite(ssim).any() else math.nan


def tile_scores(prediction: np.ndarray, photograph: np.ndarray, mask: np.ndarray) -> tuple[float, float]:
    """(PSNR in dB, SSIM) over the pixels of `mask`, (H, W) bool; images (H, W, 3), encoded, [0, 1].

    An error below a tenth of an 8-bit level counts as a tenth of a level, so that no view has an infinite PSNR.
    """
    from scipy.ndimage import binary_erosion

    if not mask.any():
        return math.nan, math.nan
    error = float(np.mean(np.square(prediction.astype(float) - photograph)[mask]))
    psnr = -10 * math.log10(max(error, (0.1 / 255) ** 2))
    side = 2 * _WINDOW_REACH + 1
    whole = binary_erosion(mask, np.ones((side, side)))  # outside the image counts as not held back
    if not whole.any():
        return psnr, math.nan
    inner = whole[_WINDOW_REACH:-_WINDOW_REACH, _WINDOW_REACH:-_WINDOW_REACH]
    return psnr, float(ssim_map(prediction, photograph)[inner].mean())
