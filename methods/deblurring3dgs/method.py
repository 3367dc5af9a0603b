"""Deblurring 3D Gaussian Splatting (Lee et al., ECCV 2024): a network enlarges every Gaussian, differently for each
view (section 3.2), and points are added once (section 3.4).

The enlarged Gaussians explain a view's blur; without the network the scene is sharp.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.training.common.networks import NetworkAdam
from dofbench.training.gaussians.blur_network import GaussianNetwork
from dofbench.training.gaussians.extra_points import GrownOnceOptions
from dofbench.training.gaussians.forward_model import BlurStart, LearnedBlur, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.gaussian_method import LenslessMethod

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


class EnlargedGaussians(LearnedBlur):
    """Renders a view with enlarged Gaussians. origin, unit: see `GaussianNetwork`."""

    needs_sharp_render = False

    def __init__(self, origin: Tensor, unit: float, options: EnlargingOptions, generator: torch.Generator):
        self._options, self.begins = options, options.enlarge_from
        # A factor below 1 is clamped and has no gradient. The published network's outputs begin near 0, and some are
        # above 1 by chance, because its inputs are in the reconstruction's unit, which may be large. Ours are of the
        # order of 1, so the outputs begin at 1, the least factor.
        self._network = GaussianNetwork(_OUTPUTS, (1.0, 1.0), origin, unit, generator)
        self._adam = NetworkAdam(self._network.named_parameters(), options.enlarge_lr, 1.0)

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Rasterise the enlarged Gaussians."""
        return scene.rasterise_with(shot.camera, self.enlarged(scene.gaussians.parameters, shot))

    def enlarged(self, parameters: dict[str, Tensor], shot: Shot) -> dict[str, Tensor]:
        """The scales and quaternions of all Gaussians for one view."""
        factors = self._network(parameters, shot.camera)
        share = self._options.enlarge_lambda
        larger, turned = ((share * found + 1 - share).clamp(1, self._options.enlarge_most) for found in factors)
        return {
            "log_scales": parameters["log_scales"] + larger.log(),
            "quaternions": parameters["quaternions"] * turned,
        }


@dataclass(frozen=True)
class EnlargedOptions(GrownOnceOptions):
    """Options of the trainer, of added points, and of the enlarging network."""

    enlarging: EnlargingOptions = EnlargingOptions()

    def learned_blur(self, start: BlurStart) -> LearnedBlur:
        return self.enlarged(start)

    def enlarged(self, start: BlurStart) -> EnlargedGaussians:
        """The enlarging network, with places relative to the mean camera centre, in units of the scene's extent."""
        return EnlargedGaussians(start.centre, start.extent, self.enlarging, start.generator)


class Deblurring3DGS(LenslessMethod):
    """Gaussians without a lens, enlarged by a network in training."""

    OPTIONS = EnlargedOptions
