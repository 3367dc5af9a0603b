"""Deblurring 3D Gaussian Splatting (Lee et al., ECCV 2024, section 3.2): a network enlarges every Gaussian by factors
that depend on the photograph. The enlarged Gaussians explain its blur; without the network the scene is sharp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.runtime.raster import Geometry
from dofbench.training.common.networks import NetworkAdam
from dofbench.training.gaussians.forward.forward_model import ForwardModel, Rasteriser, SharpView, WithoutCost
from dofbench.training.gaussians.forward.gaussian_network import GaussianNetwork
from dofbench.training.gaussians.forward.pinhole import Pinhole
from dofbench.training.gaussians.forward.shot import Shot

_OUTPUTS = (3, 4)  # factors on the scales and on the quaternion's components


@dataclass(frozen=True)
class EnlargingOptions:
    """How the network that enlarges Gaussians is learned."""

    enlarge_from: float = 0.0
    """When the network begins. Unit: share of the training. Source: Deblurring-3DGS."""
    enlarge_lambda: float = 0.01
    """Factor on the network's output o: a factor of enlargement is lambda o + 1 - lambda. Unit: none. Source:
    Deblurring-3DGS."""
    enlarge_most: float = 1.1
    """Largest factor; the least is 1. Unit: none. Source: Deblurring-3DGS."""
    enlarge_lr: float = 1e-3
    """Adam's learning rate of the network. Unit: parameter, a step. Source: Deblurring-3DGS."""


class EnlargedGaussians(WithoutCost):
    """A `ForwardModel` and `LearnedBlur`. origin, unit: of the network's places, see `GaussianNetwork`."""

    reads: Geometry = "none"
    looks = False
    from_points = False
    stage = "blur"
    kernels: tuple[str, ...] = ()

    def __init__(self, origin: Tensor, unit: float, options: EnlargingOptions, generator: torch.Generator):
        self._options = options
        # A factor below 1 is clamped and has no gradient. The published network's outputs begin near 0, and it learns
        # where a few are above 1 by chance, because its places are those of the reconstruction, which may be large.
        # Ours are of the order of 1, so the outputs begin at 1, the least factor.
        self._network = GaussianNetwork(_OUTPUTS, (1.0, 1.0), origin, unit, generator)
        self._adam = NetworkAdam(self._network.named_parameters(), options.enlarge_lr, 1.0)

    def models(self) -> Sequence[tuple[float, ForwardModel]]:
        """This model, after the sharp view if the network begins later."""
        start = self._options.enlarge_from
        return [(0.0, self)] if start <= 0 else [(0.0, Pinhole()), (start, self)]

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """The scene of enlarged Gaussians."""
        return scene.changed(shot.camera, self.enlarged(scene.gaussians.parameters, shot))

    def enlarged(self, parameters: dict[str, Tensor], shot: Shot) -> dict[str, Tensor]:
        """The scales and quaternions of all Gaussians for one photograph."""
        factors = self._network(parameters, shot.camera)
        share = self._options.enlarge_lambda
        larger, turned = ((share * found + 1 - share).clamp(1, self._options.enlarge_most) for found in factors)
        return {
            "log_scales": parameters["log_scales"] + larger.log(),
            "quaternions": parameters["quaternions"] * turned,
        }

    def gradient(self) -> Tensor | None:
        """Those by the network's parameters."""
        return self._adam.gradient()

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """An Adam step on the network."""
        self._adam.step(progress, cooldown)
