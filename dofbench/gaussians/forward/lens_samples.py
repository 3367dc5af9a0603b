"""A thin lens by a few views from points of it, each with its share of the blur: occlusion as it is in the world.

The scatter blurs one sharp image, so it can't know what a blurred foreground lets through. Here the Gaussians are
rasterised as seen from several points of the lens: shifting a Gaussian across the image by (signed circle of
confusion) x (point of the unit lens) is the sheared camera of a thin lens focused on its plane (Potmesil and
Chakravarty, 1982; Kolb et al., 1995). Each point stands for its cell of the lens, of equal area; what the cell blurs
is added to each Gaussian's footprint as a variance, so few points are enough and no ghost images appear. With no ring
there is the centre alone, whose cell is the lens (`own_blur.py`).
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

MOST_RINGS = 3  # 37 points of the lens: a picture is rendered once, and training looks at many
_CELL = 1.5  # px: radius of the cell that a point may stand for: within a cell nothing hides anything
_WIDE_PIXELS = 0.99  # quantile of a picture's circles by which its points are counted
_LEAST_DEPTH = 1e-3  # share of the median depth: nearer Gaussians, and those behind, aren't drawn but must stay finite


@dataclass(frozen=True)
class SamplesOptions:
    """How many points of the lens there are, and from when on."""

    lens_rings: int = 1
    """Rings of points around the lens's centre, 1 + 3 k (k + 1) points in all, fewer where a photograph's circles don't
    need them; 0 blurs each Gaussian by its own circle of confusion. Unit: none. Source: own; 0: DOF-GS,
    CoCoGaussian."""
    lens_samples_from: float = 0.5
    """With samples, when it takes over from the scatter. Unit: share of the training. Source: own."""
    lens_rings_from: float = 0.0
    """With samples, when the rings begin; before, the centre alone. Unit: share of the training. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_rings < 0:
            raise InputError("option lens_rings", str(self.lens_rings), "at least 0")


class LensSamples:
    """A `ForwardModel` that looks at the scene from points of the lens, no more than a photograph's circles need.

    most: rings of points, at most.
    """

    reads: Geometry = "depth"
    rasterises: tuple[Geometry, ...] = ("none",)
    stage = "lens"

    def __init__(self, blur: BlurOptions, most: int):
        self._blur, self._most = blur, most

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The mean of what the points see, in linear light."""
        rings = rings_for(shot.circles(sharp.disparity), self._most)
        return together(views_from_lens(scene, shot, rings, self._blur.blur_to_depth), self._blur.lens_gamma)


def views_from_lens(scene: Rasteriser, shot: Shot, rings: int, to_depth: bool) -> list[Tensor]:
    """(H, W, 3) each: the scene as seen from each point of the lens. to_depth: whether gradient reaches the depth by
    which Gaussians are shifted and blurred."""
    depth = depth_of(scene.gaussians, shot.camera)
    if not to_depth:
        depth = depth.detach()
    radius = shot.radius(1 / depth)
    # Turned for the centre alone too: the order of photographs is drawn from the same numbers, and doesn't depend on
    # how many points looked at them.
    pattern = lens_points(rings, scene.turn())
    blur = cell_variance(radius, len(pattern))
    return [
        scene.rasterise(
            shot.camera, "none", means=seen_from(scene.gaussians, shot.camera, depth, radius, point), blur=blur
        ).color
        for point in pattern
    ]


def rings_for(circles: Tensor, most: int = MOST_RINGS) -> int:
    """As many rings as a picture with these circles of confusion needs, and no more. circles: (H, W) radii, pixels.

    A scoring search renders some eighty pictures a photograph, most of them small ones: 37 rasterisations for circles
    of two pixels are wasted.
    """
    widest = float(np.quantile(circles.numpy(), _WIDE_PIXELS))
    return next((rings for rings in range(most) if widest <= _CELL * math.sqrt(points_of(rings))), most)


def points_of(rings: int) -> int:
    """How many points: the centre and rings of 6, 12, 18 ..."""
    return 1 + 3 * rings * (rings + 1)


def lens_points(rings: int, rotation: float = 0.0) -> np.ndarray:
    """(N, 2) points on the unit disc: the centre and rings of 6, 12, 18 ..., each for an equal area, turned by radians.

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
    """(N,) z of the means in the camera's frame, scene units, at least a little in front; with gradient."""
    means = gaussians.parameters["means"]
    pose = means.new_tensor(np.array(camera.world_to_camera))
    depth = means @ pose[2, :3] + pose[2, 3]
    in_front = depth.detach()[depth.detach() > 0]
    least = _LEAST_DEPTH * float(in_front.median()) if len(in_front) else 1.0
    return depth.clamp_min(least)


def seen_from(gaussians: Gaussians, camera: Camera, depth: Tensor, radius: Tensor, point: np.ndarray) -> Tensor:
    """(N, 3) means moved so that `camera` sees them as from a point (2,) of the unit lens.

    depth: (N,) z, scene units. radius: (N,) signed circle of confusion, pixels. Gradient reaches all three tensors.
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
    """(N,) px^2: a disc of radius R has the variance R^2 / 4 along each axis; one of so many cells, its share."""
    return radius.square() * (0.25 / points)


def together(images: list[Tensor], gamma: float) -> Tensor:
    """The mean of encoded images (H, W, 3), taken in linear light; encoded."""
    if len(images) == 1:
        return images[0]
    total = fast_decode(images[0], gamma)
    for image in images[1:]:
        total = total + fast_decode(image, gamma)
    return fast_encode(total / len(images), gamma)
