"""What learned blur kernels share: their options, and how their networks are updated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from torch import Tensor, nn

from dofbench.core.errors import InputError
from dofbench.training.common.networks import NetworkAdam


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


class LearnedKernel:
    """Base of the `RayModel`s whose kernel a network gives, without a term of the loss of its own. parameters: the
    network's, with names."""

    stage = "kernel rays"
    kernels: tuple[str, ...] = ("tone",)

    def __init__(self, parameters: Iterable[tuple[str, nn.Parameter]], options: KernelOptions):
        self._options = options
        self._adam = NetworkAdam(parameters, options.kernel_lr, options.kernel_lr_final)

    def cost(self, progress: float) -> Tensor | None:
        """None."""
        return None

    def gradients(self) -> Mapping[str, Tensor | None]:
        """Those of the network's parameters."""
        return self._adam.gradients()

    def step(self, progress: float) -> None:
        """An Adam step on the network."""
        self._adam.step(progress)
