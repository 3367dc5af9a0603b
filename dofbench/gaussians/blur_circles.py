"""How wide the circles of confusion are that learned lenses give their own photographs, and how far lenses differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from dofbench.core.lens import DisparityRange
from dofbench.gaussians.forward.shot import Shot
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.render import AppearanceOptions, rasterise
from dofbench.learning.rendered_surface import surface_disparity

_WIDE_PIXELS, _WIDE_VIEWS = 0.95, 0.9  # quantiles
_MIDDLE = 0.25, 0.75  # of the lenses; those beyond may be badly learned


@torch.no_grad()
def widest_circle(gaussians: Gaussians, shots: Sequence[Shot], appearance: AppearanceOptions) -> float:
    """Radius, pixels: the 0.95 quantile over a view's pixels, and of these the 0.9 quantile over the views, some of
    which may be in focus everywhere."""
    widest = []
    for shot in shots:
        raster = rasterise(gaussians, shot.camera, appearance, sh_degree=0)
        circles = shot.circles(surface_disparity(raster.depth, raster.alpha))
        widest.append(np.quantile(circles.numpy(), _WIDE_PIXELS))
    return float(np.quantile(widest, _WIDE_VIEWS))


@torch.no_grad()
def foci_apart(shots: Sequence[Shot], bounds: DisparityRange) -> float:
    """Pixels: how much the circle of one and the same point changes from a lens to another, for the middle half of the
    lenses, at the end of the range `bounds` where it changes more."""
    ends = np.array(
        [[float(shot.radius(torch.tensor(disparity))) for shot in shots] for disparity in (bounds.q_min, bounds.q_max)]
    )
    low, high = np.quantile(ends, _MIDDLE, axis=1)
    return float((high - low).max())
