"""The regions of a photograph in which a renderer is scored: in focus, blurred, beside a depth edge."""

from __future__ import annotations

import numpy as np

from dofbench.optics.depth_edges import near_depth_edges

REGIONS = ("all", "in focus", "blurred", "depth edge", "frame")
_SHARP = 0.5  # pixels, radius below which blur is invisible


def regions(signed_radius: np.ndarray, border: int) -> dict[str, np.ndarray]:
    """(H, W) masks by name. signed_radius: (H, W) pixels. All masks except "frame" leave out `border` pixels at the
    image's edges.

    "depth edge" has the pixels within one circle of confusion (the larger one of the two sides) of a depth edge; "in
    focus" and "blurred" are the other pixels. "frame" is the whole picture, even where light comes from outside the
    picture.
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
