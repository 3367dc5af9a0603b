"""A thin lens by a few views from points of it, each with its share of the blur: occlusion as it is in the world.

The scatter blurs one sharp image, so it can't know what a blurred foreground lets through. Here the Gaussians are
rasterised as seen from several points of the lens: shifting a Gaussian across the image by (signed circle of
confusion) x (point of the unit lens) is the sheared camera of a thin lens focused on its plane (Potmesil and
Chakravarty, 1982; Kolb et al., 1995). Each point stands for its cell of the lens, of equal area; what the cell blurs
is added to each Gaussian's footprint as a variance, so few points are enough and no ghost images appear. With no ring
there is the centre alone, whose cell is the lens: the blur per Gaussian of DOF-GS and of CoCoGaussian.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.gaussians.model import Gaussians
from dofbench.optics.tone import fast_decode, fast_encode

_LEAST_DEPTH = 1e-3  # share of the median depth: nearer Gaussians, and those behind, aren't drawn but must stay finite


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
    pose = torch.from_numpy(np.array(camera.world_to_camera)).float()
    depth = gaussians.parameters["means"] @ pose[2, :3] + pose[2, 3]
    in_front = depth.detach()[depth.detach() > 0]
    least = _LEAST_DEPTH * float(in_front.median()) if len(in_front) else 1.0
    return depth.clamp_min(least)


def seen_from(gaussians: Gaussians, camera: Camera, depth: Tensor, radius: Tensor, point: np.ndarray) -> Tensor:
    """(N, 3) means moved so that `camera` sees them as from a point (2,) of the unit lens.

    depth: (N,) z, scene units. radius: (N,) signed circle of confusion, pixels. Gradient reaches all three tensors.
    """
    right, down = (torch.from_numpy(np.array(row)).float() for row in camera.world_to_camera[:2, :3])
    across = radius * depth
    return (
        gaussians.parameters["means"]
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
