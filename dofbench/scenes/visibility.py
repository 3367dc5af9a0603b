"""Sparse points visible in a view: by their tracks, or by occlusion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    index = np.arange(len(points)) if points.views is None else points.seen_from(view)
    xy, depth = camera.project(points.xyz[index])
    inside = camera.inside(xy)
    if points.views is None:
        inside[inside] = ~hidden(xy[inside], depth[inside], camera.width)
    return Seen(index[inside], xy[inside], depth[inside])


def unmasked_points(
    points: PointCloud | None, cameras: Sequence[Camera], masks: Sequence[np.ndarray | None]
) -> PointCloud | None:
    """The points without sightings at masked pixels, and without points that lose all sightings so.

    masks: of each view, (H, W) bool, True where valid, or None. Where tracks are unknown, all points stay.
    """
    if points is None or points.views is None or all(mask is None for mask in masks):
        return points
    keep = []
    for index, (camera, mask) in enumerate(zip(cameras, masks, strict=True)):
        seen = points.seen_from(index)
        valid = np.ones(len(seen), bool)
        if mask is not None:
            xy, _ = camera.project(points.xyz[seen])
            inside = camera.inside(xy)
            column, row = xy[inside].astype(np.int64).T
            valid[inside] = mask[row, column]
        keep.append(seen[valid])
    now = points.with_sightings(keep)
    assert now.views is not None
    left = [len(track) > 0 or not len(was) for track, was in zip(now.views, points.views, strict=True)]
    return now.kept(np.array(left, bool))


def in_front(points: PointCloud, cameras: Sequence[Camera]) -> PointCloud:
    """The points with tracks limited to views that the point lies in front of. points.views index into the cameras."""
    if points.views is None:
        return points
    keep = []
    for index, camera in enumerate(cameras):
        seen = points.seen_from(index)
        keep.append(seen[camera.project(points.xyz[seen])[1] > 0])
    return points.with_sightings(keep)


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
