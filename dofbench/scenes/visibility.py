"""Which sparse points a view sees: by their tracks, or by what hides what."""

from __future__ import annotations

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
    """Points that a view sees. index: (M,) into the cloud; xy: (M, 2) image coordinates, pixels; depth: (M,) z."""

    index: np.ndarray
    xy: np.ndarray
    depth: np.ndarray


def visible(points: PointCloud, camera: Camera, view: int) -> Seen:
    """The points that view number `view` sees.

    With tracks, those whose track names the view. Without tracks, those inside the image that aren't `hidden`.
    """
    xy, depth = camera.project(points.xyz)
    seen = camera.inside(xy)
    if points.views is not None:
        seen &= points.seen_from(view)
    index = np.nonzero(seen)[0]
    if points.views is None:
        index = index[~hidden(xy[index], depth[index], camera.width)]
    return Seen(index, xy[index], depth[index])


def hidden(xy: np.ndarray, depth: np.ndarray, width: int) -> np.ndarray:
    """(P,) bool: points that are behind most of the points around them.

    xy: (P, 2) image coordinates, pixels, inside an image `width` wide; depth: (P,) z. Sparse points have
    no surfaces, so a point counts as hidden only when at least half of its neighbours are clearly nearer.
    """
    if len(xy) <= _NEIGHBOURS:
        return np.zeros(len(xy), dtype=bool)
    from scipy.spatial import cKDTree

    distance, index = cKDTree(xy).query(xy, k=_NEIGHBOURS + 1, distance_upper_bound=_RADIUS_SHARE * width)
    valid = np.isfinite(distance[:, 1:])
    neighbours = np.append(depth, np.inf)[index[:, 1:]]
    in_front = (neighbours < _HIDDEN_RATIO * depth[:, None]) & valid
    return in_front.sum(axis=1) >= np.maximum(1, _HIDING_SHARE * valid.sum(axis=1))
