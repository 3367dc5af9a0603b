"""A thin lens sampled at a few points: the mean of views from these points, which gives physically correct occlusion.

The scatter blurs one sharp image, so it can't show what is visible through a blurred foreground. Here the Gaussians are
rasterised as seen from several points of the lens: moving a Gaussian across the image by (signed circle of confusion) x
(point of the unit lens) is the sheared camera of a thin lens focused on its plane (Potmesil and Chakravarty, 1982; Kolb
et al., 1995). Each point represents a cell of the lens, all cells of equal area; the blur within a cell is added to
each Gaussian's footprint as a variance, so few points are enough and no ghost images appear (`lens_pattern.py`).
Without rings the only point is the centre, and its cell is the whole lens (`own_blur.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.optics.tone import fast_decode, fast_encode
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.raster import Geometry
from dofbench.training.gaussians.forward.forward_model import BlurOptions, Rasteriser, SharpView, WithoutCost
from dofbench.training.gaussians.forward.lens_pattern import cell_variance, lens_points, rings_for
from dofbench.training.gaussians.forward.shot import Shot
from dofbench.training.gaussians.model import Gaussians


@dataclass(frozen=True)
class SamplesOptions:
    """How many lens points are used, and from when on."""

    lens_rings: int = 1
    """Number k of rings of points on the lens: 1 has five points, k > 1 has 1 + 3 k (k + 1) in all; fewer rings are
    used for a photograph with small circles of confusion; 0 blurs each Gaussian by its own circle of confusion. Unit:
    none. Source: own; 0: DOF-GS, CoCoGaussian."""
    lens_samples_from: float = 0.5
    """With lens_model=samples, when the lens points replace the scatter. Unit: share of the training. Source: own."""
    lens_rings_from: float = 0.0
    """With lens_model=samples, when the rings begin; before that the lens's centre is the only point. Unit: share of
    the training. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_rings < 0:
            raise InputError("option lens_rings", str(self.lens_rings), "at least 0")


class LensSamples(WithoutCost):
    """A `ForwardModel` that renders the scene from points of the lens, as many as a photograph's circles of confusion
    need.

    most: largest number of rings of points.
    """

    reads: Geometry = "none"
    looks = False
    from_points = True
    stage = "lens"

    def __init__(self, blur: BlurOptions, most: int):
        self._blur, self._most = blur, most

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The mean of the views from the lens points, in linear light."""
        rings = rings_for(circles_in_view(scene.gaussians, shot), self._most)
        return together(views_from_lens(scene, shot, rings, self._blur.blur_to_depth), self._blur.lens_gamma)


def views_from_lens(scene: Rasteriser, shot: Shot, rings: int, to_depth: bool) -> Tensor:
    """(P, H, W, 3): the scene as seen from each point of the lens. to_depth: whether gradients reach the depth by
    which Gaussians are moved and blurred."""
    depth = depth_of(scene.gaussians, shot.camera)
    if not to_depth:
        depth = depth.detach()
    radius = shot.radius(1 / depth)
    # An angle is drawn for the centre alone too: the order of photographs is drawn from the same random numbers, and
    # must not depend on how many lens points are used.
    points = lens_points(rings, scene.turn())
    return scene.from_points(shot.camera, points, radius, cell_variance(radius, rings))


@torch.no_grad()
def circles_in_view(gaussians: Gaussians, shot: Shot) -> Tensor:
    """(N,) radii, pixels, of the Gaussians' circles of confusion; NaN where the camera doesn't see the mean."""
    means, camera = gaussians.parameters["means"], shot.camera
    pose = beside(means, camera.world_to_camera)
    x, y, z = (means @ pose[:3, :3].T + pose[:3, 3]).unbind(1)
    u, v = camera.pixels(x, y, z)
    seen = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return torch.where(seen, shot.circles(1 / z), math.nan)


def depth_of(gaussians: Gaussians, camera: Camera) -> Tensor:
    """(N,) z of the means in the camera's frame, scene units, raised to the near plane where it is below, since what
    isn't drawn must stay finite too; differentiable."""
    means = gaussians.parameters["means"]
    pose = beside(means, camera.world_to_camera)
    return (means @ pose[2, :3] + pose[2, 3]).clamp_min(gaussians.near)


def together(images: Tensor, gamma: float) -> Tensor:
    """The mean of P encoded images (P, H, W, 3), taken in linear light; (H, W, 3), encoded."""
    return images[0] if len(images) == 1 else fast_encode(fast_decode(images, gamma).mean(0), gamma)
