"""Where in a photograph a renderer is scored: in focus, blurred, beside a depth edge."""

from __future__ import annotations

import numpy as np

from dofbench.optics.depth_edges import near_depth_edges

REGIONS = ("all", "in focus", "blurred", "depth edge", "frame")
_SHARP = 0.5  # pixels of radius: below, no blur is seen


def regions(signed_radius: np.ndarray, border: int) -> dict[str, np.ndarray]:
    """(H, W) masks by name. `signed_radius`: (H, W) pixels; nothing within `border` pixels of the image's edges,
    but for "frame".

    "depth edge" is what lies within one circle of confusion (the larger one of its two sides) of a jump;
    "in focus" and "blurred" are the rest. "frame" is the whole picture, also where light comes from beyond it.
    """
    near_edge = near_depth_edges(signed_radius)
    inside = np.zeros(signed_radius.shape, dtype=bool)
    inside[border : -border or None, border : -border or None] = True
    sharp = np.abs(signed_radius) <= _SHARP
    return {
        "all": inside,
        "in focus": inside & ~near_edge & sharp,
        "blurred": inside & ~near_edge & ~sharp,
        "depth edge": inside & near_edge,
        "frame": np.ones(signed_radius.shape, dtype=bool),
    }
