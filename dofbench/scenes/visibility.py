"""Sparse points visible in a view: by their tracks, or by occlusion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud

_NEIGHBOURS = 12  # points around a point that may hide it
_RADIUS_SHARE = 0.03  # how far away they may be, as a share of the image width
_HIDDEN_RATIO = 0.85  # a neighbour this much nearer counts as being in front
_HIDING_SHARE = 0.5  # hidden when at least this share of the neighbours is in front


@dataclass(frozen=True, eq=False)
class Seen:
    """Visible points. index: (M,) into the cloud; xy: (M, 2) image coordinates, pixels; depth: (M,) z, scene units."""

    index: np.ndarray
    xy: np.ndarray
    depth: np.ndarray

    def within(self, mask: np.ndarray | None) -> Seen:
        """The points at pixels where mask (H, W) is true; all without a mask."""
        if mask is None:
            return self
        kept = mask[self.xy[:, 1].astype(np.int64), self.xy[:, 0].astype(np.int64)]
        return Seen(self.index[kept], self.xy[kept], self.depth[kept])


def visible(points: PointCloud, camera: Camera, view: int) -> Seen:
    """The points visible in view number `view`: by their tracks; without tracks, inside the image and not `hidden`."""
    xy, depth = camera.project(points.xyz)
    seen = camera.inside(xy)
    if points.views is not None:
        seen &= points.seen_from(view)
    index = np.nonzero(seen)[0]
    if points.views is None:
        index = index[~hidden(xy[index], depth[index], camera.width)]
    return Seen(index, xy[index], depth[index])


def unmasked_points(
    points: PointCloud | None, cameras: Sequence[Camera], masks: Sequence[np.ndarray | None]
) -> PointCloud | None:
    """The points without sightings at masked pixels, and without points that lose all sightings so.

    masks: of each view, (H, W) bool, True where valid, or None. Where tracks are unknown, all points stay.
    """
    if points is None or points.views is None or all(mask is None for mask in masks):
        return points
    masked = np.zeros((len(cameras), len(points)), bool)
    for index, (camera, mask) in enumerate(zip(cameras, masks, strict=True)):
        if mask is not None:
            xy, _ = camera.project(points.xyz)
            inside = camera.inside(xy)
            column, row = np.where(inside[:, None], xy, 0).astype(np.int64).T
            masked[index] = inside & ~mask[row, column]
    tracks = tuple(track[~masked[track, point]] for point, track in enumerate(points.views))
    kept = np.array([len(now) > 0 or not len(was) for now, was in zip(tracks, points.views, strict=True)], bool)
    return replace(points, views=tracks).kept(kept)


def in_front(points: PointCloud, cameras: Sequence[Camera]) -> PointCloud:
    """The points with tracks limited to views that the point lies in front of. points.views index into the cameras."""
    if points.views is None:
        return points
    before = np.stack([camera.project(points.xyz)[1] > 0 for camera in cameras])
    return replace(points, views=tuple(track[before[track, index]] for index, track in enumerate(points.views)))


def hidden(xy: np.ndarray, depth: np.ndarray, width: int) -> np.ndarray:
    """(P,) bool: points behind at least half of their neighbours in the image, clearly: sparse points have no surface.

    xy: (P, 2) image coordinates, pixels, inside an image `width` wide; depth: (P,) z.
    """
    if len(xy) <= _NEIGHBOURS:
        return np.zeros(len(xy), dtype=bool)
    from scipy.spatial import cKDTree

    distance, index = cKDTree(xy).query(xy, k=_NEIGHBOURS + 1, distance_upper_bound=_RADIUS_SHARE * width)
    valid = np.isfinite(distance[:, 1:])
    neighbours = np.append(depth, np.inf)[index[:, 1:]]
    in_front = (neighbours < _HIDDEN_RATIO * depth[:, None]) & valid
    return in_front.sum(axis=1) >= np.maximum(1, _HIDING_SHARE * valid.sum(axis=1))
