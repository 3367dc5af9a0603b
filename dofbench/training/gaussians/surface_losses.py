"""Losses on rendered surfaces: normal consistency (DoF-Gaussian, Eq. 12) and distortion (released code, after 2DGS)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from dofbench.core.cameras import Camera


@dataclass(frozen=True)
class NormalOptions:
    """How strongly normals are made consistent with depth, and in which form."""

    normal_weight: float = 0.05
    """w_n, the weight of the loss; 0 switches it off. Unit: none. Source: Eq. 12, supplement."""
    normal_from: float = 0.0
    """When the loss begins to act. Unit: share of the training. Source: paper; 0.5 in the released code."""
    normal_median: float = 0.0
    """Weight of the normals of the median depth; those of the expected depth have the remaining weight. Unit: share.
    Source: own; 0.6 in the released code."""
    normal_form: Literal["splats", "pixel"] = "splats"
    """splats: the sum over a pixel's splats; pixel: a comparison of the pixel's blended normal, at unit length. Unit:
    none. Source: splats: Eq. 12; pixel: released code."""


def normals_from_depth(depth: Tensor, camera: Camera) -> Tensor:
    """(H-2, W-2, 3) unit normals in the camera's frame, towards the camera, by central differences of the
    back-projected z-depth (H, W)."""
    height, width = depth.shape
    columns, rows = (torch.arange(size, dtype=depth.dtype, device=depth.device) for size in (width, height))
    x, y = camera.rays(columns + 0.5, rows + 0.5)
    points = torch.stack([x * depth, y[:, None] * depth, depth], dim=-1)
    along_x = points[1:-1, 2:] - points[1:-1, :-2]
    along_y = points[2:, 1:-1] - points[:-2, 1:-1]
    return torch.nn.functional.normalize(torch.linalg.cross(along_y, along_x), dim=-1)


def normal_consistency(
    normal: Tensor,
    alpha: Tensor,
    depth: Tensor,
    median_depth: Tensor,
    camera: Camera,
    median_share: float,
    form: Literal["splats", "pixel"] = "splats",
) -> Tensor:
    """Mean difference of rendered normals from the normals n^ of the depth, without the border.

    "splats" is Eq. 12, the sum over a pixel's splats of w (1 - n . n^): alpha minus the blended normal along n^.
    "pixel" is 1 - n . n^ for the blended normal n at unit length (released code); 1 where no surface is rendered.
    """
    if form == "pixel":
        there = alpha.detach()[..., None] > 0
        normal = torch.nn.functional.normalize(torch.where(there, normal, 1.0), dim=-1) * there
        alpha = torch.ones_like(alpha)
    loss = normal.new_zeros(())
    for share, surface in ((1 - median_share, depth), (median_share, median_depth)):
        if share > 0:
            geometric = normals_from_depth(surface, camera)
            agreement = (normal[1:-1, 1:-1] * geometric).sum(dim=-1)
            loss = loss + share * (alpha[1:-1, 1:-1] - agreement).mean()
    return loss


@dataclass(frozen=True)
class DistortionOptions:
    """How strongly a ray's Gaussians are drawn together, and between which depths."""

    distortion_weight: float = 0.0
    """The weight of the loss; 0 switches it off. Unit: none. Source: own; 100 in the released code."""
    distortion_from: float = 0.5
    """When the loss begins to act. Unit: share of the training. Source: released code."""
    distortion_near: float = 0.2
    """Near bound n of the depth's mapping to 0 to 1. Unit: scene units. Source: released code."""
    distortion_far: float = 100.0
    """Far bound f of the depth's mapping to 0 to 1. Unit: scene units. Source: released code."""


def distortion_loss(distortion: Tensor, alpha: Tensor, image: Tensor, near: float, far: float) -> Tensor:
    """The released code's distortion loss (docs/published-methods.md, "Losses").

    The mean over the pixels of distortion / alpha^2, of depth mapped to [0, 1] by m = (f z - f n) / ((f - n) z), times
    exp(-g), with g the largest difference of the image's colour to the four neighbours, mean over the channels, since
    depth may jump where colour does. Pixels at the border count as 0. distortion: (H, W), 1 / scene unit^2, of
    disparity; over alpha^2 it is the variance among the pixel's Gaussians. image: (H, W, 3). near, far: scene units.
    """
    there = alpha.detach() > 0
    # m is affine in disparity: differences of m are this many times the differences of 1 / z.
    scale = far * near / (far - near)
    spread = scale**2 * distortion / torch.where(there, alpha, 1.0).square()
    inner = image[1:-1, 1:-1]
    neighbours = (image[1:-1, :-2], image[1:-1, 2:], image[:-2, 1:-1], image[2:, 1:-1])
    edges = torch.stack([(inner - neighbour).abs().mean(dim=-1) for neighbour in neighbours]).amax(dim=0)
    return (spread[1:-1, 1:-1] * torch.exp(-edges)).sum() / spread.numel()
