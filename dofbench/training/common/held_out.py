"""Held-out pixels: tiles of the training views that no colour loss uses, kept for scoring settings against each other.

Sparse points, depth priors and the first Gaussians' colours come from the whole images, so only trainings with the same
of these can be compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dofbench.core.held_out import held_out_tiles, tile_scores
from dofbench.core.masks import touched


@dataclass(frozen=True)
class HeldOutScores:
    """Scores on held-out pixels alone; means over the views. views: name -> (PSNR in dB, SSIM).

    ssim: over the pixels whose window is in held-out tiles; NaN for a view without any, which the mean excludes.
    """

    psnr: float
    ssim: float
    views: Mapping[str, tuple[float, float]]


def held_out_mask(
    height: int, width: int, shown: tuple[int, int], share: float, seed: int, view: int
) -> np.ndarray | None:
    """`held_out_tiles` of a view (height, width), at the size (height, width) `shown`, bool; None for a share of 0."""
    if share <= 0:
        return None
    tiles = held_out_tiles(height, width, share, seed, view)
    return touched(tiles, shown[1], shown[0])


def held_out_scores(
    images: Iterable[tuple[str, np.ndarray]],
    render: Callable[[int], np.ndarray],
    share: float,
    seed: int,
    masks: Sequence[np.ndarray | None] | None = None,
) -> HeldOutScores:
    """Score renderings of the training views on held-out pixels.

    images: name and (H, W, 3) encoded of each view, in the training set's order. render: the rendering of a view by its
    number, (H, W, 3) encoded. share, seed: as trained with. masks: (H, W) bool of each view or None, False for pixels
    that aren't scored. A view without a valid held-out pixel has the scores NaN, and doesn't count. Raises ValueError
    for a share of 0.
    """
    if share <= 0:
        raise ValueError(f"held-out scores: expected a share above 0, found {share}")
    views = {}
    for number, (name, image) in enumerate(images):
        height, width = image.shape[:2]
        tiles = held_out_tiles(height, width, share, seed, number)
        if masks is not None and (valid := masks[number]) is not None:
            tiles &= valid
        views[name] = tile_scores(np.clip(render(number), 0, 1), image, tiles)
    psnr, ssim = np.array(list(views.values())).T
    if np.isnan(psnr).any() and not np.isnan(psnr).all():
        return HeldOutScores(float(np.nanmean(psnr)), _mean(ssim), views)
    return HeldOutScores(float(psnr.mean()), _mean(ssim), views)


def _mean(ssim: np.ndarray) -> float:
    return float(np.nanmean(ssim)) if np.isfinite(ssim).any() else math.nan
