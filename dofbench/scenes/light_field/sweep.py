"""Disparity of a light field's view by a plane sweep over its neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dofbench.scenes.light_field.average import shifted
from dofbench.scenes.light_field.grid import Place

MARGIN = 0.15  # pixels per view step beyond the range of known disparities that a sweep needs
_GUIDE_RADIUS, _GUIDE_EPSILON = 5, 1e-4
_NEIGHBOURHOOD = 4  # planes around the best one that aren't compared with it
CLEAR_MARGIN = 0.01  # encoded grey: a disparity that is better by this margin gets full weight
# The smoother reaches 3 pixels where the weight is 1, and 300 where it is least. Edge: grey levels of 255.
_SMOOTHNESS, _EDGE = 10.0, 6.0


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another view. image: (H, W, 3) float32, encoded. place: relative to the swept view, steps. offset: (down, right),
    pixels by which a point of disparity 1 moves from the swept view to this one."""

    image: np.ndarray
    place: Place
    offset: tuple[float, float]

    def at(self, disparity: float) -> np.ndarray:
        """The image shifted so that points of this disparity are where the swept view has them."""
        return shifted(self.image, (disparity * self.offset[0], disparity * self.offset[1]))


@dataclass(frozen=True, eq=False)
class Swept:
    """disparity: (H, W) float64, in the unit of the neighbours' offsets. confidence: (H, W) float32: by how much the
    best plane is better than distant ones, 0 not at all ... 1 by `CLEAR_MARGIN`."""

    disparity: np.ndarray
    confidence: np.ndarray


def sweep(view: np.ndarray, neighbours: Sequence[Neighbour], low: float, high: float, step: float) -> Swept:
    """Disparity of the view, (H, W, 3) float32, encoded, between `low` and `high`, by planes `step` apart.

    For each candidate, all neighbours are shifted onto the view. Their difference is averaged over the best half of
    them (left, right, upper or lower; next to an edge only one side sees the point) and smoothed along edges (Rhemann
    et al., Fast Cost-Volume Filtering, 2011). The best disparity is refined by a parabola. Where it isn't clearly
    better than distant ones, it is interpolated up to the next edge (fast global smoother, Min et al., 2014, weighted
    by the squared margin).
    """
    import cv2

    candidates = np.arange(low, high + step, step)
    sides = [
        [index for index, one in enumerate(neighbours) if sign * one.place[axis] >= 0]
        for axis in (0, 1)
        for sign in (1, -1)
    ]
    costs = []
    for candidate in candidates:
        differences = [np.minimum(np.abs(one.at(candidate) - view).mean(axis=2), 0.1) for one in neighbours]
        cost = np.min([np.mean([differences[index] for index in side], axis=0) for side in sides if side], axis=0)
        costs.append(cv2.ximgproc.guidedFilter(view, cost.astype(np.float32), _GUIDE_RADIUS, _GUIDE_EPSILON))
    volume = np.stack(costs)
    best = np.clip(volume.argmin(axis=0), 1, len(candidates) - 2)
    before, here, after = (np.take_along_axis(volume, (best + k)[None], 0)[0] for k in (-1, 0, 1))
    curvature = before - 2 * here + after
    offset = np.where(curvature > 1e-9, 0.5 * (before - after) / np.maximum(curvature, 1e-9), 0.0)
    disparity = candidates[best] + step * np.clip(offset, -0.5, 0.5)
    far_from_best = np.abs(np.arange(len(candidates))[:, None, None] - best) > _NEIGHBOURHOOD
    margin = np.where(far_from_best, volume, np.inf).min(axis=0) - here
    weight = np.clip(margin / CLEAR_MARGIN, 0.01, 1.0).astype(np.float32) ** 2
    guide = np.clip(view * 255 + 0.5, 0, 255).astype(np.uint8)
    smoother = cv2.ximgproc.createFastGlobalSmootherFilter(guide, _SMOOTHNESS, _EDGE)
    smooth = smoother.filter((weight * disparity).astype(np.float32)) / smoother.filter(weight)
    return Swept(smooth.astype(np.float64), np.clip(margin / CLEAR_MARGIN, 0.0, 1.0).astype(np.float32))
