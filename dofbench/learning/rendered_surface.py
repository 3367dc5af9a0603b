"""The surface that a view was rendered with: its disparity, and the range of it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import DisparityRange

# Below this accumulated opacity a pixel has no surface whose depth means anything.
SURFACE_ALPHA = 0.1
_RANGE_QUANTILE = 0.95  # the released code's near end of the disparity range


def surface_disparity(depth: Tensor, alpha: Tensor) -> Tensor:
    """(H, W) disparity, 1 / scene unit; a pixel without a surface takes the farthest one of the image.

    The released code takes such pixels for the nearest of all, which blurs holes over their
    surroundings; what shows through a hole lies behind.
    """
    there = (alpha > SURFACE_ALPHA) & (depth > 0)
    disparity = 1 / torch.where(there, depth, 1.0)
    if bool(there.all()):
        return disparity
    farthest = disparity.detach()[there].min() if bool(there.any()) else disparity.new_zeros(())
    return torch.where(there, disparity, farthest)


def rendered_range(disparity: Tensor, alpha: Tensor, fallback: DisparityRange) -> DisparityRange:
    """Minimum and 95th percentile of disparity (H, W) over the pixels that have a surface, as the released code scales
    it; `fallback` where there is no such pixel, or no range."""
    known = disparity.detach()[alpha.detach() > SURFACE_ALPHA].numpy()
    if known.size == 0:
        return fallback
    low, high = float(known.min()), float(np.quantile(known, _RANGE_QUANTILE))
    return DisparityRange(low, high) if high > low else fallback
