"""How wide the learned lenses' circles of confusion are in their own photographs, and how far the lenses differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from dofbench.core.lens import DisparityRange
from dofbench.training.common.rendered_surface import surface_disparity
from dofbench.training.gaussians.forward.shot import Shot
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise

_WIDE_PIXELS, _WIDE_VIEWS = 0.95, 0.9  # quantiles
_MIDDLE = 0.25, 0.75  # quantiles of the lenses; lenses outside them may be badly learned


@torch.no_grad()
def widest_circle(gaussians: Gaussians, shots: Sequence[Shot], appearance: AppearanceOptions) -> float:
    """Radius of the widest circles of confusion, pixels: the 0.95 quantile over a view's pixels, then the 0.9 quantile
    over the views, since some views may be in focus everywhere."""
    widest = []
    for shot in shots:
        raster = rasterise(gaussians, shot.camera, appearance, sh_degree=0)
        assert raster.depth is not None
        circles = shot.circles(surface_disparity(raster.depth, raster.alpha))
        widest.append(np.quantile(circles.numpy(force=True), _WIDE_PIXELS))
    return float(np.quantile(widest, _WIDE_VIEWS))


@torch.no_grad()
def foci_apart(shots: Sequence[Shot], bounds: DisparityRange) -> float:
    """How much the circle of confusion of one point differs between lenses, pixels of a camera of the median focal
    length: the spread over the middle half of the lenses, at that end of the disparity range `bounds` where the spread
    is larger."""
    focal = np.array([shot.camera.fx for shot in shots])
    ends = np.array(
        [[float(shot.radius(torch.tensor(disparity))) for shot in shots] for disparity in (bounds.q_min, bounds.q_max)]
    )
    low, high = np.quantile(ends * (np.median(focal) / focal), _MIDDLE, axis=1)
    return float((high - low).max())
