"""The loss of a predicted photograph (DoF-Gaussian, Eq. 7), and the pixels that it must not use."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.ops import load

WHITE = 254.5 / 255  # least value that an 8-bit image stores as white


@dataclass(frozen=True)
class ReconstructionOptions:
    """The weights of the reconstruction loss, and the pixels that it leaves out."""

    ssim_weight: float = 0.2
    """lambda of (1 - lambda) L1 + lambda (1 - SSIM). Unit: none. Source: Eq. 7; 3DGS."""
    edge_weight: float = 0.0
    """Weight of the error of the edges, the mean absolute difference between the errors of neighbouring pixels, which
    is added to the loss. What a blurred photograph still shows of fine detail has little contrast, and more weight in
    this term than in the others. Unit: none. Source: own."""
    held_back: float = 0.0
    """How many tiles of every photograph are kept from all colour losses, for scoring. Unit: share of the tiles.
    Source: own."""
    clipped_white: bool = False
    """Whether a prediction above white has no loss where the photograph is white, since the sensor clipped there. Unit:
    none. Source: own."""

    def __post_init__(self) -> None:
        if not 0 <= self.held_back < 1:
            raise InputError("option held_back", str(self.held_back), "a share of 0 to below 1")
        if self.edge_weight < 0:
            raise InputError("option edge_weight", str(self.edge_weight), "at least 0")


def reconstruction(
    prediction: Tensor,
    target: Tensor,
    ssim_weight: float,
    weight: Tensor | None,
    weigh_all: bool = False,
    edge_weight: float = 0.0,
) -> Tensor:
    """Eq. 7: (1 - lambda) L1 + lambda (1 - SSIM) of images (H, W, 3), and edge_weight times the error of the edges;
    `weight` (H, W) acts on the L1 term, and on the two others too if `weigh_all` is true (Eq. 13)."""
    loss = load("ssim", function="l1_ssim")
    return loss(
        prediction, target, ssim_weight=ssim_weight, weight=weight, weigh_all=weigh_all, edge_weight=edge_weight
    )


def looked_at(
    prediction: Tensor,
    target: Tensor,
    held_back: Tensor | None = None,
    clipped_white: bool = False,
) -> Tensor:
    """The prediction, replaced by the target where no loss may be taken, so that loss and gradient are zero there.

    prediction, target: (H, W, 3). held_back: (H, W) bool, or None if no pixel is held back. clipped_white: a channel
    that is white in the target may have been clipped by the sensor, so any prediction at or above white counts as
    right.
    """
    if clipped_white:
        prediction = torch.where((target >= WHITE) & (prediction >= target), target, prediction)
    return prediction if held_back is None else torch.where(held_back[..., None], target, prediction)
