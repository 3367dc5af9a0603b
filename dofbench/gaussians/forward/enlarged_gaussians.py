"""Deblurring 3D Gaussian Splatting (Lee et al., ECCV 2024, section 3.2): a network enlarges every Gaussian by factors
that depend on the photograph. The enlarged Gaussians explain its blur; without the network the scene is sharp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.compute.raster import Geometry
from dofbench.gaussians.forward.forward_model import ForwardModel, Rasteriser, SharpView, WithoutCost
from dofbench.gaussians.forward.pinhole import Pinhole
from dofbench.gaussians.forward.shot import Shot
from dofbench.learning.networks import NetworkAdam, encoded_places, redraw

_PLACE_FREQUENCIES, _CAMERA_FREQUENCIES = 3, 10
_WIDTH, _HIDDEN = 64, 3
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
    """A `ForwardModel` and `LearnedBlur`.

    origin: (3,) world point, and unit: scene units, in which the network's places are given; the published code takes
    those of the reconstruction, which are arbitrary.
    """

    reads: Geometry = "none"
    looks = False
    from_points = False
    stage = "blur"

    def __init__(self, origin: Tensor, unit: float, options: EnlargingOptions, generator: torch.Generator):
        self._origin, self._unit, self._options = origin, unit, options
        self._network = _EnlargingNetwork(generator)
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
        scales, quaternions = parameters["log_scales"], parameters["quaternions"]
        unit = torch.nn.functional.normalize(quaternions.detach(), dim=1)
        centre = torch.from_numpy(shot.camera.centre.copy()).float()
        places, camera = ((place - self._origin) / self._unit for place in (parameters["means"].detach(), centre))
        factors = self._network(places, camera, scales.detach().exp() / self._unit, unit)
        share = self._options.enlarge_lambda
        larger, turned = ((share * found + 1 - share).clamp(1, self._options.enlarge_most) for found in factors)
        return {"log_scales": scales + larger.log(), "quaternions": quaternions * turned}

    def gradient(self) -> Tensor | None:
        """Those by the network's parameters."""
        found = [gradient.flatten() for gradient in self._adam.gradients().values() if gradient is not None]
        return torch.cat(found) if found else None

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """An Adam step on the network."""
        self._adam.step(progress, cooldown)


class _EnlargingNetwork(nn.Module):
    """From a Gaussian and a camera's place to two groups of factors, for the scales and for the quaternion."""

    def __init__(self, generator: torch.Generator):
        super().__init__()
        own = 3 * (1 + 2 * _PLACE_FREQUENCIES) + 7
        camera = 3 * (1 + 2 * _CAMERA_FREQUENCIES)
        # The camera's place is the same for all Gaussians, so its part of the first layer is computed once.
        self.first, self.camera = nn.Linear(own, _WIDTH), nn.Linear(camera, _WIDTH, bias=False)
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise([_WIDTH] * _HIDDEN))
        # An output below 1 is clamped and has no gradient. The published network begins near 0, and learns where a few
        # outputs are above 1 by chance, because its places are those of the reconstruction, which may be large. Ours
        # are of the order of 1, so its outputs begin at 1, the least factor.
        self.head = nn.Linear(_WIDTH, sum(_OUTPUTS))
        redraw(self, generator)
        with torch.no_grad():
            _xavier((self.first, self.camera), own + camera, generator)
            for layer in (*self.hidden, self.head):
                _xavier((layer,), _WIDTH, generator)
            self.head.bias.fill_(1.0)

    def forward(self, places: Tensor, camera: Tensor, scales: Tensor, quaternions: Tensor) -> tuple[Tensor, ...]:
        """((N, 3), (N, 4)). places: (N, 3) and camera: (3,), in the network's unit, as are the scales (N, 3);
        quaternions: (N, 4), of length 1."""
        inputs = torch.cat([encoded_places(places, _PLACE_FREQUENCIES), scales, quaternions], 1)
        features = torch.relu(self.first(inputs) + self.camera(encoded_places(camera, _CAMERA_FREQUENCIES)))
        for layer in self.hidden:
            features = torch.relu(layer(features))
        found: Tensor = self.head(features)
        return found.split(_OUTPUTS, dim=1)


def _xavier(layers: Sequence[nn.Linear], inputs: int, generator: torch.Generator) -> None:
    """Draw weights from Xavier's normal distribution (Glorot and Bengio, 2010). inputs: of all these layers together,
    which are parts of one."""
    for layer in layers:
        deviation = (2 / (inputs + layer.out_features)) ** 0.5
        layer.weight.normal_(0, deviation, generator=generator)
