"""How blurred photographs are, told from the photographs.

A photograph with shallow depth of field has depths at which nothing is sharp. So the sharpest detail is looked for at
each depth that the sparse points have: how much a second, known blur takes from the gradients around a point tells how
blurred they were before (Zhuo and Sim, 2011, who compare single edges; here it is energies in a window). Texture that
is smooth by itself looks blurred too, which is why only the sharpest of many points at one depth counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dofbench.optics.blur_width import LUMA, blur_deviation
from dofbench.scenes.visibility import Seen

DEPTHS = 6  # bins of disparity
LEAST_POINTS = 15  # in a bin of a view
SHARPEST = 0.1  # quantile over a bin's points that stands for its sharpest detail
OWN_SOFTNESS = 0.7  # px: lens, sensor and scaling blur a photograph in focus by this much at most
WIDEST = 0.75  # quantile over the views: some may see only things that are in focus


def largest_blur(images: Iterable[np.ndarray], seen: Sequence[Seen]) -> float | None:
    """Radius in pixels of the largest circle of confusion that the photographs show; None where they don't tell.

    images: (H, W, 3) encoded. Good to about half a pixel: photographs in focus give up to 0.6.
    """
    disparity = np.concatenate([1 / view.depth for view in seen])
    if not len(disparity):
        return None
    near, far = np.quantile(disparity, (0.99, 0.01))
    extent = max(near - far, np.finfo(float).tiny)
    sharpest = np.full((len(seen), DEPTHS), np.nan)
    for row, image, view in zip(sharpest, images, seen, strict=True):
        deviation = blur_deviation(np.asarray(image, np.float64) @ LUMA)
        found = deviation[view.xy[:, 1].astype(int), view.xy[:, 0].astype(int)]
        depth = np.clip(((1 / view.depth - far) / extent * DEPTHS).astype(int), 0, DEPTHS - 1)
        for k in range(DEPTHS):
            values = found[(depth == k) & np.isfinite(found)]
            if len(values) >= LEAST_POINTS:
                row[k] = np.quantile(values, SHARPEST)
    told = sharpest[np.isfinite(sharpest).any(axis=1)]
    if not len(told):
        return None
    own = min(np.nanquantile(told, SHARPEST), OWN_SOFTNESS)
    widest = np.nanmax(told, axis=1)
    # A disc of radius R has the standard deviation R / 2 along an axis, and variances add up.
    return float(np.quantile(2 * np.sqrt(np.maximum(widest**2 - own**2, 0)), WIDEST))
