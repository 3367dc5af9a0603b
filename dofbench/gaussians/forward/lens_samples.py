"""A thin lens sampled at a few points: the mean of views from these points, which gives physically correct occlusion.

The scatter blurs one sharp image, so it can't show what is visible through a blurred foreground. Here the Gaussians are
rasterised as seen from several points of the lens: shifting a Gaussian across the image by (signed circle of
confusion) x (point of the unit lens) is the sheared camera of a thin lens focused on its plane (Potmesil and
Chakravarty, 1982; Kolb et al., 1995). Each point represents a cell of the lens, all cells of equal area; the blur
within a cell is added to each Gaussian's footprint as a variance, so few points are enough and no ghost images appear.
Without rings the only point is the centre, and its cell is the whole lens (`own_blur.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from dofbench.compute.raster import Geometry
from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.gaussians.forward.forward_model import BlurOptions, Rasteriser, SharpView
from dofbench.gaussians.forward.shot import Shot
from dofbench.gaussians.model import Gaussians
from dofbench.optics.tone import fast_decode, fast_encode

MOST_RINGS = 3  # 37 lens points: affordable in rendering, where each picture is rendered once; training uses fewer
_CELL = 1.5  # px: largest blur radius of one cell; occlusion within a cell is ignored
_WIDE_PIXELS = 0.99  # quantile of a picture's circles of confusion that decides how many points it needs
# Share of the median depth, to which smaller depths are raised: such Gaussians aren't drawn but must stay finite
_LEAST_DEPTH = 1e-3


@dataclass(frozen=True)
class SamplesOptions:
    """How many lens points are used, and from when on."""

    lens_rings: int = 1
    """Number k of rings of points around the lens's centre, 1 + 3 k (k + 1) points in all; fewer rings are used for a
    photograph with small circles of confusion; 0 blurs each Gaussian by its own circle of confusion. Unit: none.
    Source: own; 0: DOF-GS, CoCoGaussian."""
    lens_samples_from: float = 0.5
    """With lens_model=samples, when the lens points replace the scatter. Unit: share of the training. Source: own."""
    lens_rings_from: float = 0.0
    """With lens_model=samples, when the rings begin; before that the lens's centre is the only point. Unit: share of
    the training. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_rings < 0:
            raise InputError("option lens_rings", str(self.lens_rings), "at least 0")


class LensSamples:
    """A `ForwardModel` that renders the scene from points of the lens, as many as a photograph's circles of confusion
    need.

    most: largest number of rings of points.
    """

    reads: Geometry = "depth"
    rasterises: tuple[Geometry, ...] = ("none",)
    stage = "lens"

    def __init__(self, blur: BlurOptions, most: int):
        self._blur, self._most = blur, most

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The mean of the views from the lens points, in linear light."""
        rings = rings_for(shot.circles(sharp.disparity), self._most)
        return together(views_from_lens(scene, shot, rings, self._blur.blur_to_depth), self._blur.lens_gamma)


def views_from_lens(scene: Rasteriser, shot: Shot, rings: int, to_depth: bool) -> list[Tensor]:
    """(H, W, 3) each: the scene as seen from each point of the lens. to_depth: whether gradients reach the depth by
    which Gaussians are shifted and blurred."""
    depth = depth_of(scene.gaussians, shot.camera)
    if not to_depth:
        depth = depth.detach()
    radius = shot.radius(1 / depth)
    # An angle is drawn for the centre alone too: the order of photographs is drawn from the same random numbers, and
    # must not depend on how many lens points are used.
    pattern = lens_points(rings, scene.turn())
    blur = cell_variance(radius, len(pattern))
    return [
        scene.rasterise(
            shot.camera, "none", means=seen_from(scene.gaussians, shot.camera, depth, radius, point), blur=blur
        ).color
        for point in pattern
    ]


def rings_for(circles: Tensor, most: int = MOST_RINGS) -> int:
    """The smallest number of rings that suits a picture with these circles of confusion. circles: (H, W) radii, pixels.

    The search for a lens in scoring renders some eighty pictures per photograph, most of them with small circles, for
    which 37 rasterisations would be a waste.
    """
    widest = float(np.quantile(circles.numpy(), _WIDE_PIXELS))
    return next((rings for rings in range(most) if widest <= _CELL * math.sqrt(points_of(rings))), most)


def points_of(rings: int) -> int:
    """How many points so many rings have in all: the centre and rings of 6, 12, 18 ..."""
    return 1 + 3 * rings * (rings + 1)


def lens_points(rings: int, rotation: float = 0.0) -> np.ndarray:
    """(N, 2) points on the unit disc: the centre and rings of 6, 12, 18 ..., each for an equal area. rotation: radians.

    The radius of a ring is such that points and cells together have the disc's variance, 1/4 along each axis, and
    each ring with its cells the variance of its annulus.
    """
    count = points_of(rings)
    points = [(0.0, 0.0)]
    for ring in range(1, rings + 1):
        radius = math.sqrt((0.5 + 3 * ring**2) / count)
        angles = rotation + 2 * math.pi * (np.arange(6 * ring) + 0.5 * (ring % 2)) / (6 * ring)
        points += [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]
    return np.array(points)


def depth_of(gaussians: Gaussians, camera: Camera) -> Tensor:
    """(N,) z of the means in the camera's frame, scene units, raised to a small positive number where it is below;
    differentiable."""
    means = gaussians.parameters["means"]
    pose = means.new_tensor(np.array(camera.world_to_camera))
    depth = means @ pose[2, :3] + pose[2, 3]
    in_front = depth.detach()[depth.detach() > 0]
    least = _LEAST_DEPTH * float(in_front.median()) if len(in_front) else 1.0
    return depth.clamp_min(least)


def seen_from(gaussians: Gaussians, camera: Camera, depth: Tensor, radius: Tensor, point: np.ndarray) -> Tensor:
    """(N, 3) means, moved so that `camera` sees them as a point (2,) of the unit lens does.

    depth: (N,) z, scene units. radius: (N,) signed circle of confusion, pixels. Gradients reach the means, depth and
    radius.
    """
    means = gaussians.parameters["means"]
    right, down = (means.new_tensor(np.array(row)) for row in camera.world_to_camera[:2, :3])
    across = radius * depth
    return (
        means
        + (across * float(point[0] / camera.fx))[:, None] * right
        + (across * float(point[1] / camera.fy))[:, None] * down
    )


def cell_variance(radius: Tensor, points: int) -> Tensor:
    """(N,) px^2: variance of the blur of one cell. A disc of radius R has the variance R^2 / 4 along each axis, and
    each of its `points` cells an equal share."""
    return radius.square() * (0.25 / points)


def together(images: list[Tensor], gamma: float) -> Tensor:
    """The mean of encoded images (H, W, 3), taken in linear light; encoded."""
    if len(images) == 1:
        return images[0]
    total = fast_decode(images[0], gamma)
    for image in images[1:]:
        total = total + fast_decode(image, gamma)
    return fast_encode(total / len(images), gamma)
