"""Where a picture's depth jumps, and what of the picture its blur brings together there."""

from __future__ import annotations

import numpy as np

JUMP = 1.0  # pixels of signed radius between neighbours: from there on one hides the other visibly


def near_depth_edges(signed_radius: np.ndarray) -> np.ndarray:
    """(H, W) mask of what lies within one circle of confusion, the larger one of its two sides, of a jump.

    signed_radius: (H, W) pixels.
    """
    import cv2

    reach = np.zeros(signed_radius.shape)  # of every pixel beside a jump
    for axis in (0, 1):
        length = signed_radius.shape[axis] - 1
        first, second = (np.take(signed_radius, range(start, length + start), axis) for start in (0, 1))
        jump = np.abs(first - second) > JUMP
        wide = np.where(jump, np.maximum(np.maximum(np.abs(first), np.abs(second)), 1.0), 0.0)
        for start in (0, 1):
            place = [slice(None), slice(None)]
            place[axis] = slice(start, length + start)
            np.maximum(reach[tuple(place)], wide, out=reach[tuple(place)])
    near = np.zeros(signed_radius.shape, dtype=bool)
    # Whole radii suffice: a region is a place to look, not a measurement.
    for whole in np.unique(np.ceil(reach[reach > 0])):
        distance = cv2.distanceTransform((np.ceil(reach) != whole).astype(np.uint8), cv2.DIST_L2, 5)
        near |= distance <= whole
    return near
