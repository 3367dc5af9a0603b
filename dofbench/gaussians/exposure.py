"""The forward models: from Gaussians and a lens to a photograph with shallow depth of field.

A lens is given as the signed circle of confusion `slope * d + offset` in units of 2 % of the width, d being the
normalised disparity (`lenses.py`); slope and offset are tensors in training and numbers in rendering.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.compute.raster import Raster, ViewStatistics
from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import COC_FRACTION, ApertureShape, DisparityRange, PhysicalLens
from dofbench.gaussians.lens_samples import cell_variance, depth_of, lens_points, points_of, seen_from, together
from dofbench.gaussians.losses import step_function
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.render import rasterise, surface_disparity
from dofbench.learning.options import TrainerOptions
from dofbench.optics.defocus import defocus

_MOST_RINGS = 3  # 37 points of the lens: a picture is rendered once, and training looks at many
_CELL = 1.5  # px: radius of the cell that a point may stand for: within a cell nothing hides anything
_WIDE_PIXELS = 0.99  # quantile of a picture's circles by which its points are counted


@dataclass(frozen=True, eq=False)
class Shot:
    """How a photograph is taken: the camera, the lens, and the range that its disparities refer to."""

    camera: Camera
    bounds: DisparityRange
    slope: Tensor | float
    offset: Tensor | float

    def radius(self, disparity: Tensor, options: TrainerOptions, adapting: bool) -> Tensor:
        """Signed circle of confusion, pixels, of disparities (1 / scene unit); with Eq. 11 where `adapting`."""
        normalised = self.bounds.normalise(disparity)
        radius = (COC_FRACTION * self.camera.width) * (self.slope * normalised + self.offset)
        if adapting and options.adaptation_aperture:
            radius = radius * step_function(self.out_of_focus(disparity), options)
        return radius

    @torch.no_grad()
    def circles(self, depth: Tensor, alpha: Tensor, options: TrainerOptions) -> Tensor:
        """(H, W) circles of confusion, pixels, of the surface that was rendered with depth and alpha, both (H, W)."""
        return self.radius(surface_disparity(depth, alpha), options, False).abs()

    def out_of_focus(self, disparity: Tensor) -> Tensor:
        """|normalised disparity - focus|, without gradient."""
        slope, offset = (value.item() if isinstance(value, Tensor) else value for value in (self.slope, self.offset))
        focus = -offset / slope if slope else 0.0
        return (self.bounds.normalise(disparity.detach()) - focus).abs()


def blur_of(options: TrainerOptions) -> Blur:
    """How the trained lens blurs, whatever its aperture and focus."""
    shape = ApertureShape(options.lens_blades, options.lens_rotation)
    return Blur(options.lens_gamma, options.lens_alpha, shape, options.lens_energy)


def scattered(colour: Tensor, disparity: Tensor, shot: Shot, options: TrainerOptions, adapting: bool = False) -> Tensor:
    """The paper's model: a sharp rendering (H, W, 3), scattered by its disparity (H, W), 1 / scene unit."""
    return defocus(colour, shot.radius(disparity, options, adapting), blur_of(options))


def sampled(
    gaussians: Gaussians,
    shot: Shot,
    options: TrainerOptions,
    rings: int,
    *,
    rotation: float = 0.0,
    sh_degree: int | None = None,
    want_abs: bool = False,
    adapting: bool = False,
) -> tuple[list[Raster], list[ViewStatistics]]:
    """The scene as rasterised from each point of the lens (`lens_samples.py`), and each one's statistics."""
    depth = depth_of(gaussians, shot.camera)
    if not options.blur_to_depth:
        depth = depth.detach()
    radius = shot.radius(1 / depth, options, adapting)
    pattern = lens_points(rings, rotation)
    blur = cell_variance(radius, len(pattern))
    rasters, statistics = [], []
    for point in pattern:
        statistics.append(ViewStatistics(want_abs=want_abs))
        means = seen_from(gaussians, shot.camera, depth, radius, point)
        rasters.append(
            rasterise(
                gaussians,
                shot.camera,
                options,
                sh_degree=sh_degree,
                geometry="none",
                means=means,
                blur=blur,
                statistics=statistics[-1],
            )
        )
    return rasters, statistics


def summed(statistics: list[ViewStatistics]) -> ViewStatistics:
    """Statistics of several renderings as those of one: gradients add up, as the photograph's does."""
    whole = ViewStatistics(want_abs=statistics[0].want_abs)
    whole.visible = torch.stack([one.visible for one in statistics]).any(dim=0)
    whole.radii = torch.stack([one.radii for one in statistics]).amax(dim=0)
    whole.grad_2d = torch.stack([one.grad_2d for one in statistics]).sum(dim=0)
    if whole.want_abs:
        whole.abs_grad_2d = torch.stack([one.abs_grad_2d for one in statistics]).sum(dim=0)
    return whole


def rings_for(circles: Tensor, most: int = _MOST_RINGS) -> int:
    """As many rings as a picture with these circles of confusion needs, and no more. circles: (H, W) radii, pixels.

    A scoring search renders some eighty pictures a photograph, most of them small ones: 37 rasterisations for circles
    of two pixels are wasted.
    """
    widest = float(np.quantile(circles.numpy(), _WIDE_PIXELS))
    return next((rings for rings in range(most) if widest <= _CELL * math.sqrt(points_of(rings))), most)


@torch.no_grad()
def render_view(
    gaussians: Gaussians, camera: Camera, options: TrainerOptions, *, lens: PhysicalLens | None
) -> Rendering:
    """Image and depth at any camera; all in focus when `lens` is None."""
    raster = rasterise(gaussians, camera, options)
    image = raster.color
    if lens is not None:
        slope = lens.aperture / (COC_FRACTION * lens.width)
        shot = Shot(camera, DisparityRange(0.0, 1.0), slope, -slope * lens.focus_disparity)
        if options.lens_model == "samples":
            rings = 0
            if options.lens_rings > 0:
                most = max(options.lens_rings, _MOST_RINGS)
                rings = rings_for(shot.circles(raster.depth, raster.alpha, options), most)
            rasters, _ = sampled(gaussians, shot, options, rings)
            image = together([sample.color for sample in rasters], options.lens_gamma)
        else:
            image = scattered(image, surface_disparity(raster.depth, raster.alpha), shot, options)
    return Rendering(image=image.numpy(), depth=raster.depth.numpy())
