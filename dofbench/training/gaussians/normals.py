"""Normal consistency (DoF-Gaussian, Eq. 12): rendered normals against those of the rendered depth."""

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
    """(H-2, W-2, 3) unit normals in the camera's frame, towards the camera, by central differences.

    Back-projects z-depth (H, W) through the pixel centres.
    """
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
    """Difference of the rendered normals from the normals n^ of the depth, averaged over the pixels within the border.

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
