"""What learned blur kernels share: their options, a network's optimiser, and the encoding of its inputs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dofbench.core.errors import InputError


@dataclass(frozen=True)
class KernelOptions:
    """When a blur kernel is learned, and how fast."""

    kernel_points: int = 5
    """Rays that a pixel is mixed from. Unit: none. Source: Deblur-NeRF, DP-NeRF."""
    kernel_from: float = 0.006
    """When the kernel begins; before it a pixel is one ray. Unit: share of the training. Source: Deblur-NeRF, DP-NeRF,
    step 1200 of 200 000."""
    kernel_lr: float = 5e-4
    """Adam's learning rate of the kernel's network at the start. Unit: parameter, a step. Source: Deblur-NeRF."""
    kernel_lr_final: float = 0.16
    """Share of it that is left at the end; it falls exponentially. Unit: none. Source: Deblur-NeRF, 0.1^(200 / 250)."""

    def __post_init__(self) -> None:
        if self.kernel_points < 2:
            raise InputError("option kernel_points", str(self.kernel_points), "at least 2")


class KernelAdam:
    """Adam over a network's parameters, at a rate that falls."""

    def __init__(self, network: nn.Module, options: KernelOptions):
        self._network, self._options = network, options
        self._adam = torch.optim.Adam(network.parameters(), lr=options.kernel_lr)

    def gradients(self) -> dict[str, Tensor | None]:
        """Gradients of the network's parameters by name."""
        return {name: parameter.grad for name, parameter in self._network.named_parameters()}

    def step(self, progress: float) -> None:
        """Update by the gradients, which are then dropped; nothing happens before there are any."""
        for group in self._adam.param_groups:
            group["lr"] = self._options.kernel_lr * self._options.kernel_lr_final**progress
        self._adam.step()
        self._adam.zero_grad()


def encoded_places(values: Tensor, frequencies: int) -> Tensor:
    """(..., D (1 + 2 F)): values (..., D) in radians with the sines and cosines of 2^k times them (NeRF, Eq. 4)."""
    scaled = [values * 2.0**k for k in range(frequencies)]
    return torch.cat([values, *(wave(angle) for angle in scaled for wave in (torch.sin, torch.cos))], -1)
