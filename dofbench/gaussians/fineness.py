"""No Gaussian finer than the photographs could show it.

Mip-Splatting's 3D filter keeps a Gaussian from being finer than the finest sampling of any view. A lens samples more
coarsely still: what all photographs saw through a wide circle of confusion, any number of sharp scenes explain, and
training picks needles among them. So a Gaussian is kept at least as wide as a share of the smallest circle with which
any photograph saw it.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dofbench.cameras import Camera
from dofbench.gaussians.exposure import Shot
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.options import TrainerOptions


@torch.no_grad()
def coarsen(gaussians: Gaussians, cameras: Sequence[Camera], shots: Sequence[Shot], options: TrainerOptions) -> None:
    """Widen the Gaussians that are finer, along each of their axes, than `options.fineness` allows.

    shots: the cameras with their lenses. A disc of radius R has the standard deviation R / 2 along an axis.
    """

    def deviation(view: int, depth: Tensor) -> Tensor:
        radius = shots[view].radius(1 / depth.clamp_min(1e-6), options, False)
        return (0.5 * options.fineness) * radius.abs()

    least = gaussians.finest(cameras, deviation)
    scales = gaussians.parameters["log_scales"]
    scales.copy_(torch.maximum(scales, least.clamp_min(1e-12).log()[:, None]))
