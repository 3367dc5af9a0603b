"""The disparity range of a scene: exact percentiles over all views, one view in memory at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from dofbench.core.lens import DisparityRange

SCENE_PERCENTILES = (1.0, 99.0)  # conventions: the scene's normaliser
VIEW_PERCENTILES = (0.0, 95.0)  # minimum and 95th percentile, as the released DoF-Gaussian code normalises a view


def scene_range(depth_maps: Callable[[], Iterable[np.ndarray]]) -> DisparityRange:
    """Percentiles 1 and 99 of the disparity of all known pixels of all views, as `DisparityRange.of_disparity`.

    depth_maps: called twice, yields every view's depth (H, W) float32, scene units, 0 where unknown. Positive float32
    values sort as their bit patterns, so counting upper halves, then the lower halves of the few that matter, finds any
    rank without keeping a map. Raises ValueError when no pixel is known.
    """
    upper = np.zeros(1 << 16, dtype=np.int64)
    for depth in depth_maps():
        upper += np.bincount(_bits(depth) >> 16, minlength=1 << 16)
    total = int(upper.sum())
    if total == 0:
        raise ValueError("disparity range: expected at least one pixel of known depth, found none")

    # numpy's percentile: position p / 100 * (n - 1), linear between the two ranks around it.
    positions = [percentile / 100 * (total - 1) for percentile in SCENE_PERCENTILES]
    below = [int(np.floor(position)) for position in positions]
    # Disparity ascends as depth descends: rank r of disparity is rank n - 1 - r of depth.
    ranks = sorted({total - 1 - min(rank + step, total - 1) for rank in below for step in (0, 1)})
    cumulative = np.cumsum(upper)
    half_of = {rank: int(np.searchsorted(cumulative, rank, side="right")) for rank in ranks}
    lower = {half: np.zeros(1 << 16, dtype=np.int64) for half in half_of.values()}
    for depth in depth_maps():
        bits = _bits(depth)
        for half, counts in lower.items():
            counts += np.bincount(bits[bits >> 16 == half] & 0xFFFF, minlength=1 << 16)

    disparity = {}
    for rank, half in half_of.items():
        inside = rank - (int(cumulative[half]) - int(upper[half]))
        low = int(np.searchsorted(np.cumsum(lower[half]), inside, side="right"))
        depth = np.array([(half << 16) | low], dtype=np.uint32).view(np.float32)
        disparity[total - 1 - rank] = 1.0 / float(depth[0])
    ends = []
    for position, rank in zip(positions, below, strict=True):
        following = disparity[min(rank + 1, total - 1)]
        ends.append(disparity[rank] + (position - rank) * (following - disparity[rank]))
    return DisparityRange.of_disparity(np.array(ends), 0.0, 100.0)


def view_range(depth: np.ndarray) -> DisparityRange:
    """One view's own normaliser: minimum and 95th percentile of its disparity. depth as in `scene_range`."""
    known = depth[depth > 0].astype(np.float64)
    return DisparityRange.of_disparity(1.0 / known, *VIEW_PERCENTILES)


def disparity_of(depth: np.ndarray) -> np.ndarray:
    """1 / depth in float64; unknown depth (0) counts as infinitely far, disparity 0, as `dofbench.optics.defocus`."""
    return np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0, dtype=np.float64)


def _bits(depth: np.ndarray) -> np.ndarray:
    known = np.ascontiguousarray(depth[(depth > 0) & np.isfinite(depth)], dtype=np.float32)
    return known.view(np.uint32)
