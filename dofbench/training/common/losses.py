"""The colour loss (DoF-Gaussian, Eq. 7), the pixels that it skips, and the adaptation (Eq. 10, 11, 13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.runtime.ops import load

WHITE = 254.5 / 255  # least value that an 8-bit image stores as white


@dataclass(frozen=True)
class ReconstructionOptions:
    """The weights of the reconstruction loss, and the pixels that it excludes."""

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
    """Eq. 7: (1 - lambda) L1 + lambda (1 - SSIM) of images (H, W, 3), and edge_weight times the error of the edges.
    weight: (H, W), on the L1 term, with `weigh_all` on all terms (Eq. 13)."""
    loss = load("ssim", function="l1_ssim")
    return loss(
        prediction, target, ssim_weight=ssim_weight, weight=weight, weigh_all=weigh_all, edge_weight=edge_weight
    )


def without_held_out(
    prediction: Tensor, target: Tensor, held_back: Tensor | None = None, clipped_white: bool = False
) -> Tensor:
    """Replace the prediction by the target where no loss may be taken, so that loss and gradient are zero there.

    prediction, target: (H, W, 3). held_back: (H, W) bool, or None. clipped_white: where a channel of the target is
    white, the sensor may have clipped it, and any prediction at or above white counts as right.
    """
    if clipped_white:
        prediction = torch.where((target >= WHITE) & (prediction >= target), target, prediction)
    return prediction if held_back is None else torch.where(held_back[..., None], target, prediction)


@dataclass(frozen=True)
class AdaptationOptions:
    """How out-of-focus pixels are given less weight, and from when on."""

    adaptation: Literal["off", "psi", "one_minus_psi"] = "one_minus_psi"
    """How the L1 and depth terms of the loss are weighted: off; psi, the printed Eq. 13; one_minus_psi, what the
    paper's text says. Unit: none. Source: Eq. 13; one_minus_psi: released code."""
    adaptation_from: float = 1 / 3
    """When the adaptation begins. Unit: share of the training. Source: released code, 10 000 of 30 000 steps."""
    adaptation_ssim: bool = False
    """Whether the weight acts on the D-SSIM term and on the edges too, pixel by pixel. Unit: none. Source: on: Eq. 13,
    whose weight is of the whole reconstruction loss; off: released code."""
    adaptation_aperture: bool = False
    """Whether the aperture is also narrowed for pixels in focus, A' = A psi. Unit: none. Source: Eq. 11; off in
    the released code."""
    adaptation_a: float = 15.0
    """Slope a of psi(x) = 1 / (1 + exp(-a (x - b))). Unit: 1 / normalised disparity. Source: Eq. 10, released code."""
    adaptation_b: float = 0.3
    """Threshold b of psi: the distance from the focus at which it is 1/2. Unit: normalised disparity. Source: Eq. 10,
    released code."""

    @property
    def active(self) -> bool:
        """Whether loss or aperture is adapted at all."""
        return self.adaptation != "off" or self.adaptation_aperture

    def at(self, progress: float) -> AdaptationOptions:
        """The options at `progress`, 0 to 1: without adaptation before `adaptation_from`."""
        return self if progress >= self.adaptation_from else NO_ADAPTATION

    def psi(self, out_of_focus: Tensor) -> Tensor:
        """Psi of Eq. 10; large where a pixel is out of focus."""
        return torch.sigmoid(self.adaptation_a * (out_of_focus - self.adaptation_b))

    def loss_weight(self, out_of_focus: Tensor) -> Tensor | None:
        """(H, W) weight of the loss, or None. out_of_focus: (H, W), |normalised disparity - focus|.

        "psi" is Eq. 13 as printed. "one_minus_psi" is the text's; like the released code it first stretches x to [0, 1]
        within the image.
        """
        match self.adaptation:
            case "off":
                return None
            case "psi":
                return self.psi(out_of_focus)
        low, high = out_of_focus.min(), out_of_focus.max()
        return 1 - self.psi((out_of_focus - low) / (high - low).clamp(min=1e-12))


NO_ADAPTATION = AdaptationOptions(adaptation="off")
