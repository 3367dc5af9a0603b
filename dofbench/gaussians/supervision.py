"""Sparse depth of every view from the structure-from-motion points (section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.cameras import Camera
from dofbench.contracts import PointCloud

_NEIGHBOURS = 12       # points around a point that may hide it
_RADIUS_SHARE = 0.03   # how far away they may be, as a share of the image width
_HIDDEN_RATIO = 0.85   # a neighbour this much nearer counts as being in front
_HIDING_SHARE = 0.5    # hidden when at least this share of the neighbours is in front


@dataclass(frozen=True, eq=False)
class SparseDepth:
    """rows, columns: (M,) int64 pixels; depth: (M,) float32 z in scene units."""

    rows: Tensor
    columns: Tensor
    depth: Tensor


def sparse_depth(points: PointCloud, camera: Camera, view: int) -> SparseDepth:
    """The points that view number `view` sees, projected to pixels.

    With tracks, those whose track names the view. Without tracks, those inside the image that are
    not behind most of the points around them: sparse points have no surfaces, so a point counts
    as hidden only when at least half of its neighbours in the image are clearly nearer.
    """
    xy, depth = camera.project(points.xyz)
    with np.errstate(invalid="ignore"):
        seen = (depth > 0) & (xy >= 0).all(axis=1) & (xy[:, 0] < camera.width) & (xy[:, 1] < camera.height)
    if points.views is not None:
        tracked = np.fromiter((view in track for track in points.views), dtype=bool, count=len(points))
        seen &= tracked
    chosen = np.nonzero(seen)[0]
    if points.views is None and len(chosen) > _NEIGHBOURS:
        chosen = chosen[~_hidden(xy[chosen], depth[chosen], _RADIUS_SHARE * camera.width)]
    pixels = xy[chosen].astype(np.int64)
    return SparseDepth(
        rows=torch.from_numpy(pixels[:, 1].copy()),
        columns=torch.from_numpy(pixels[:, 0].copy()),
        depth=torch.from_numpy(depth[chosen].astype(np.float32)),
    )


def _hidden(xy: np.ndarray, depth: np.ndarray, radius: float) -> np.ndarray:
    from scipy.spatial import cKDTree

    distance, index = cKDTree(xy).query(xy, k=_NEIGHBOURS + 1, distance_upper_bound=radius)
    valid = np.isfinite(distance[:, 1:])
    neighbours = np.append(depth, np.inf)[index[:, 1:]]
    in_front = (neighbours < _HIDDEN_RATIO * depth[:, None]) & valid
    return in_front.sum(axis=1) >= np.maximum(1, _HIDING_SHARE * valid.sum(axis=1))


def all_disparities(points: PointCloud, cameras: list[Camera]) -> np.ndarray:
    """Disparities, 1 / scene unit, of all points over all views that see them."""
    found = [1.0 / sparse_depth(points, camera, index).depth.numpy() for index, camera in enumerate(cameras)]
    return np.concatenate(found)
