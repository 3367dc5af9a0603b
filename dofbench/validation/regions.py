"""Where in a photograph a renderer is scored: in focus, blurred, beside a depth edge."""

from __future__ import annotations

import numpy as np

REGIONS = ("all", "in focus", "blurred", "depth edge")
_EDGE_JUMP = 1.0  # pixels of signed radius between neighbours: from there on one hides the other visibly
_SHARP = 0.5      # pixels of radius: below, no blur is seen


def regions(signed_radius: np.ndarray, border: int) -> dict[str, np.ndarray]:
    """(H, W) masks by name. `signed_radius`: (H, W) pixels; nothing within `border` pixels of the image's edges.

    "depth edge" is what lies within one circle of confusion (the larger one of its two sides) of a jump;
    "in focus" and "blurred" are the rest.
    """
    near_edge = _near_edges(signed_radius)
    inside = np.zeros(signed_radius.shape, dtype=bool)
    inside[border : -border or None, border : -border or None] = True
    sharp = np.abs(signed_radius) <= _SHARP
    return {
        "all": inside, "in focus": inside & ~near_edge & sharp, "blurred": inside & ~near_edge & ~sharp,
        "depth edge": inside & near_edge,
    }


def _near_edges(radius: np.ndarray) -> np.ndarray:
    import cv2

    reach = np.zeros(radius.shape)  # of every pixel beside a jump
    for axis in (0, 1):
        first, second = (np.take(radius, range(start, radius.shape[axis] - 1 + start), axis) for start in (0, 1))
        jump = np.abs(first - second) > _EDGE_JUMP
        wide = np.where(jump, np.maximum(np.maximum(np.abs(first), np.abs(second)), 1.0), 0.0)
        for start in (0, 1):
            place = [slice(None), slice(None)]
            place[axis] = slice(start, radius.shape[axis] - 1 + start)
            np.maximum(reach[tuple(place)], wide, out=reach[tuple(place)])
    near = np.zeros(radius.shape, dtype=bool)
    # Whole radii suffice: a region is a place to look, not a measurement.
    for whole in np.unique(np.ceil(reach[reach > 0])):
        distance = cv2.distanceTransform((np.ceil(reach) != whole).astype(np.uint8), cv2.DIST_L2, 5)
        near |= distance <= whole
    return near
