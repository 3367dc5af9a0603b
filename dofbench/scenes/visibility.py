"""Which sparse points a view can't see, where no track says so."""

from __future__ import annotations

import numpy as np

_NEIGHBOURS = 12       # points around a point that may hide it
_RADIUS_SHARE = 0.03   # how far away they may be, as a share of the image width
_HIDDEN_RATIO = 0.85   # a neighbour this much nearer counts as being in front
_HIDING_SHARE = 0.5    # hidden when at least this share of the neighbours is in front


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
