"""A small network on a Gaussian and a camera's place (Deblurring 3D Gaussian Splatting, section 3.2; CoCoGaussian has
the same)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.core.cameras import Camera
from dofbench.runtime.device_numbers import beside
from dofbench.training.common.networks import encoded_places, rectified, redraw

_PLACE_FREQUENCIES, _CAMERA_FREQUENCIES = 3, 10
_WIDTH, _HIDDEN = 64, 3


class GaussianNetwork(nn.Module):
    """From every Gaussian's mean, scales and rotation, and a camera's centre, to groups of outputs.

    sizes: of the groups. first: the outputs' bias of each group. origin: (3,) world point, and unit: scene units, of
    the inputs; the published codes use the reconstruction's, which are arbitrary.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        first: Sequence[float],
        origin: Tensor,
        unit: float,
        generator: torch.Generator,
    ):
        super().__init__()
        self._sizes, self._origin, self._unit = list(sizes), origin, unit
        own = 3 * (1 + 2 * _PLACE_FREQUENCIES) + 7
        camera = 3 * (1 + 2 * _CAMERA_FREQUENCIES)
        # The camera's part of the first layer is the same for all Gaussians, so it is computed once.
        self.first, self.camera = nn.Linear(own, _WIDTH), nn.Linear(camera, _WIDTH, bias=False)
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise([_WIDTH] * _HIDDEN))
        self.head = nn.Linear(_WIDTH, sum(sizes))
        redraw(self, generator)
        with torch.no_grad():
            _xavier((self.first, self.camera), own + camera, generator)
            for layer in (*self.hidden, self.head):
                _xavier((layer,), _WIDTH, generator)
            for part, value in zip(self.head.bias.split(self._sizes), first, strict=True):
                part.fill_(value)
        self.to(origin.device)

    def forward(self, parameters: Mapping[str, Tensor], camera: Camera) -> tuple[Tensor, ...]:
        """(N, size) for each group. parameters: the Gaussians', which get no gradient."""
        means = parameters["means"].detach()
        places, eye = ((place - self._origin) / self._unit for place in (means, beside(means, camera.centre)))
        scales = parameters["log_scales"].detach().exp() / self._unit
        turns = nn.functional.normalize(parameters["quaternions"].detach())
        inputs = torch.cat([encoded_places(places, _PLACE_FREQUENCIES), scales, turns], 1)
        features = rectified(self.first, inputs, self.camera(encoded_places(eye, _CAMERA_FREQUENCIES)))
        for layer in self.hidden:
            features = rectified(layer, features)
        found: Tensor = self.head(features)
        return found.split(self._sizes, dim=1)


def _xavier(layers: Sequence[nn.Linear], inputs: int, generator: torch.Generator) -> None:
    """Draw weights from Xavier's normal distribution (Glorot and Bengio, 2010). inputs: of the layers together, which
    are parts of one."""
    for layer in layers:
        deviation = (2 / (inputs + layer.out_features)) ** 0.5
        layer.weight.normal_(0, deviation, generator=generator)
