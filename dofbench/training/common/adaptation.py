"""Defocus-to-focus adaptation (DoF-Gaussian, Eq. 10, 11, 13): late in training, pixels in focus get more weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor


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
        """The options to use at `progress`, 0 to 1: these ones, or before `adaptation_from` options without
        adaptation."""
        return self if progress >= self.adaptation_from else NO_ADAPTATION

    def psi(self, out_of_focus: Tensor) -> Tensor:
        """Psi of Eq. 10, as it is once the adaptation has begun; large where a pixel is out of focus."""
        return torch.sigmoid(self.adaptation_a * (out_of_focus - self.adaptation_b))

    def loss_weight(self, out_of_focus: Tensor) -> Tensor | None:
        """(H, W) weight of the loss, None without a weight; `out_of_focus` (H, W) is |normalised disparity -
        focus|.

        "psi" is Eq. 13 as printed. "one_minus_psi" is what the text describes; like the released code
        it first stretches x to [0, 1] within the image.
        """
        match self.adaptation:
            case "off":
                return None
            case "psi":
                return self.psi(out_of_focus)
        low, high = out_of_focus.min(), out_of_focus.max()
        return 1 - self.psi((out_of_focus - low) / (high - low).clamp(min=1e-12))


NO_ADAPTATION = AdaptationOptions(adaptation="off")
