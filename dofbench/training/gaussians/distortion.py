"""The distortion loss: draws a ray's Gaussians together in depth (released code, after 2DGS; not in the paper)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


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
    """The released code's distortion loss (docs/published-methods.md, "Losses"): draws a ray's Gaussians together in
    depth.

    The mean over the pixels of distortion / alpha^2, of depth mapped to [0, 1] by m = (f z - f n) / ((f - n) z), times
    exp(-g); g is the largest absolute difference of the photograph's colour, mean over its channels, to the four
    neighbours, since depth may jump where colour does. Pixels at the border count as 0. distortion: (H, W), 1 / scene
    unit^2, the rasteriser's distortion of disparity; divided by alpha^2 it is the variance of disparity among the
    pixel's Gaussians. image: (H, W, 3). near, far: scene units.
    """
    there = alpha.detach() > 0
    # m is affine in disparity: differences of m are this many times the differences of 1 / z.
    scale = far * near / (far - near)
    spread = scale**2 * distortion / torch.where(there, alpha, 1.0).square()
    inner = image[1:-1, 1:-1]
    neighbours = (image[1:-1, :-2], image[1:-1, 2:], image[:-2, 1:-1], image[2:, 1:-1])
    edges = torch.stack([(inner - neighbour).abs().mean(dim=-1) for neighbour in neighbours]).amax(dim=0)
    return (spread[1:-1, 1:-1] * torch.exp(-edges)).sum() / spread.numel()
