"""The disparity of a rendered view's surface, and its range."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from dofbench.core.lens import DisparityRange
from dofbench.runtime.ops import load

# A pixel with less accumulated opacity has no surface with a meaningful depth.
SURFACE_ALPHA = 0.1
_RANGE_QUANTILE = 0.95  # near end of the disparity range in the released code


def surface_disparity(depth: Tensor, alpha: Tensor) -> Tensor:
    """(H, W) disparity, 1 / scene unit; a pixel without a surface gets the farthest surface's disparity in the image.

    The released code treats such pixels as the nearest of all, which spreads the blur of holes over their surroundings.
    Here they count as far, since a hole shows what lies behind.
    """
    disparity: Tensor = load("surface")(depth, alpha, SURFACE_ALPHA)
    return disparity


def rendered_range(disparity: Tensor, alpha: Tensor, fallback: DisparityRange) -> DisparityRange:
    """Minimum and 95th percentile of disparity (H, W) over the pixels that have a surface, as in the released code;
    `fallback` if there is no such pixel, or all have the same disparity."""
    known = disparity.detach()[alpha.detach() > SURFACE_ALPHA].numpy(force=True)
    if known.size == 0:
        return fallback
    low, high = float(known.min()), float(np.quantile(known, _RANGE_QUANTILE))
    return DisparityRange(low, high) if high > low else fallback
