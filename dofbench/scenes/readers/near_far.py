"""Near and far bounds, scene units, as LLFF's layout states them for every view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_NEAR_FAR = (0.1, 99.9)  # percentiles of depth that are LLFF's near and far bounds


def depth_bounds(depths: Sequence[np.ndarray]) -> np.ndarray | None:
    """(N, 2) near and far, from the depths (any number of each) that are known in each of N views.

    A view without any gets the nearest and the farthest bound of all views. None if no view has any.
    """
    bounds = np.array([np.percentile(known, _NEAR_FAR) if known.size else (np.nan, np.nan) for known in depths])
    told = np.isfinite(bounds[:, 0])
    if not told.any():
        return None
    bounds[~told] = bounds[told, 0].min(), bounds[told, 1].max()
    return bounds
