"""Which pixels of a test view some training view shows, by sparse points alone: the same for every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.scenes.visibility import visible

CELL = 4  # px: a pixel has its cell's value
NEAREST = 8  # points whose disparities a cell may have
FEWEST = 64  # fewest visible points for a map

Frame = tuple[Camera, np.ndarray | None]  # of a training view, with its mask (H, W) or None


def covered(points: PointCloud, camera: Camera, training: Sequence[Frame]) -> np.ndarray | None:
    """(H, W) bool: whether a pixel's surface lies inside a training view's frame, at a valid pixel; None if unknown.

    The surface is at the smallest, the mean or the largest disparity of the eight nearest sparse points. A pixel is
    uncovered only if none of the three is in any frame. Occlusion is ignored, so that it may be covered and hidden.
    """
    from scipy.spatial import cKDTree

    seen = visible(replace(points, views=None), camera, 0)
    if len(seen.index) < FEWEST:
        return None
    rows, columns = (np.arange(CELL / 2, size + CELL / 2, CELL) for size in (camera.height, camera.width))
    x, y = (grid.ravel() for grid in np.meshgrid(columns, rows))
    _, index = cKDTree(seen.xy).query(np.stack([x, y], axis=1), k=NEAREST)
    near = 1.0 / seen.depth[index]
    ray = np.stack([*camera.rays(x, y), np.ones_like(x)], axis=1)
    found = np.zeros(len(x), dtype=bool)
    for disparity in (near.min(axis=1), near.mean(axis=1), near.max(axis=1)):
        local = ray / disparity[:, None]
        world = local @ camera.camera_to_world[:3, :3].T + camera.centre
        for frame, mask in training:
            found[~found] = _inside(world[~found], frame, mask)
    cells = found.reshape(len(rows), len(columns))
    return cells.repeat(CELL, axis=0).repeat(CELL, axis=1)[: camera.height, : camera.width]


def _inside(world: np.ndarray, camera: Camera, mask: np.ndarray | None) -> np.ndarray:
    """(P,) bool: which points (P, 3) project on a valid pixel."""
    xy, _ = camera.project(world)
    inside = camera.inside(xy)
    if mask is not None:
        column, row = xy[inside].astype(np.int64).T
        inside[inside] = mask[row, column]
    return inside
