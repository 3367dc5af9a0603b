"""Depth edges of an image, and the region around them in which blur mixes near and far surfaces."""

from __future__ import annotations

import numpy as np

JUMP = 1.0  # pixels, difference of neighbouring signed radii above which occlusion is visible


def near_depth_edges(signed_radius: np.ndarray) -> np.ndarray:
    """(H, W) mask of the pixels within one CoC radius (the larger of both sides) of a depth edge.

    signed_radius: (H, W) pixels.
    """
    import cv2

    reach = np.zeros(signed_radius.shape)  # CoC radius of every pixel next to a depth edge
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
    # Radii are rounded up to whole pixels.
    for whole in np.unique(np.ceil(reach[reach > 0])):
        distance = cv2.distanceTransform((np.ceil(reach) != whole).astype(np.uint8), cv2.DIST_L2, 5)
        near |= distance <= whole
    return near
