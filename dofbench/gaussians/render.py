"""From Gaussians to sharp images and depth: what training, evaluation and a loaded model share."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.compute.raster import Geometry, Raster, ViewStatistics
from dofbench.core.cameras import Camera
from dofbench.gaussians.model import Gaussians
from dofbench.kernels import load
from dofbench.learning.options import TrainerOptions

# Below this accumulated opacity a pixel has no surface whose depth means anything.
SURFACE_ALPHA = 0.1


def rasterise(
    gaussians: Gaussians,
    camera: Camera,
    options: TrainerOptions,
    *,
    sh_degree: int | None = None,
    geometry: Geometry = "depth",
    statistics: ViewStatistics | None = None,
    blur: Tensor | None = None,
    means: Tensor | None = None,
) -> Raster:
    """The rasteriser kernel with the method's filters and background.

    Without `sh_degree` all harmonics count; those that training hasn't reached yet are zero. blur: (N,) px^2, each
    Gaussian's own, as the kernel documents it. means: (N, 3) scene units, instead of the Gaussians' own.
    Gradients reach both.
    """
    degree = options.sh_degree if sh_degree is None else sh_degree
    background = torch.full((3,), options.background) if options.background else None
    parameters = gaussians.parameters if means is None else {**gaussians.parameters, "means": means}
    return load("rasterize")(
        **parameters,
        camera=camera,
        sh_degree=degree,
        geometry=geometry,
        filter_3d=gaussians.filter_3d if options.filter_3d else None,
        filter_2d=options.filter_2d,
        blur=blur,
        background=background,
        statistics=statistics,
    )


def surface_disparity(depth: Tensor, alpha: Tensor) -> Tensor:
    """(H, W) disparity, 1 / scene unit; a pixel without a surface takes the farthest one of the image.

    The released code takes such pixels for the nearest of all, which blurs holes over their
    surroundings; what shows through a hole lies behind.
    """
    there = (alpha > SURFACE_ALPHA) & (depth > 0)
    disparity = 1 / torch.where(there, depth, 1.0)
    if bool(there.all()):
        return disparity
    farthest = disparity.detach()[there].min() if bool(there.any()) else torch.zeros(())
    return torch.where(there, disparity, farthest)
