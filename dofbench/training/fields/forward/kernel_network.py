"""The network of Deblur-NeRF's deformable sparse kernel (Ma et al., CVPR 2022, section 4.2): from a photograph, a pixel
and a canonical point to the point's move, its ray's origin and its weight."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.training.common.networks import encoded_places, rectified, redraw
from dofbench.training.fields.forward.ray_model import RayScene
from dofbench.training.fields.pixels import Pixels

_EMBEDDING, _WIDTH, _HIDDEN, _FREQUENCIES = 32, 64, 4, 2
_FIRST_SPREAD = 0.1  # standard deviation of the canonical points' parameters at the start
_ORIGIN = 0.01  # of the unit of depth: what the network's origins are multiplied by


@dataclass(frozen=True, eq=False)
class KernelRays:
    """The N rays that each of P pixels is mixed from. places: (P, N, 2), from the pixel, px. origins: (P, N, 2), from
    the camera's centre, units of depth. weights: (P, N), which add up to 1 for a pixel."""

    places: Tensor
    origins: Tensor
    weights: Tensor

    def in_world(self, scene: RayScene, pixels: Pixels, unit: float) -> tuple[Tensor, Tensor]:
        """(P N, 3) origins and directions. unit: the depth, scene units, that counts as 1: a moved ray still passes
        there through the point that its place says."""
        shift = unit * self.origins
        return scene.cameras.rays(
            pixels.views.repeat_interleave(self.places.shape[1]),
            (pixels.places[:, None] + self.places).reshape(-1, 2),
            shift.reshape(-1, 2),
            -shift.reshape(-1, 2) / unit,
        )


class KernelNetwork(nn.Module):
    """Of `points` rays a pixel. features: numbers that are told about each ray, beside what Deblur-NeRF's network is
    told."""

    def __init__(self, views: int, points: int, generator: torch.Generator, features: int = 0):
        super().__init__()
        self.pattern = nn.Parameter(_FIRST_SPREAD * torch.randn(views, points, 2, generator=generator))
        self.embedding = nn.Parameter(torch.zeros(views, _EMBEDDING))
        inputs = _EMBEDDING + 4 * (1 + 2 * _FREQUENCIES) + features
        widths = [inputs, *[_WIDTH] * _HIDDEN]
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.head = nn.Linear(_WIDTH + inputs, 5)
        redraw(self, generator)

    def canonical(self, views: Tensor) -> Tensor:
        """(P, N, 2) canonical points of the pixels' photographs, each coordinate from -1 to 1."""
        return torch.tanh(self.pattern[views])

    def forward(
        self, views: Tensor, points: Tensor, places: Tensor, window: float, features: Tensor | None = None
    ) -> KernelRays:
        """The rays. points: (P, N, 2), and window, pixels. places: (P, 2), 0 to 1 across the photograph. features:
        (P, N, F), if the network is told any."""
        count = points.shape[1]
        each = [
            self.embedding[views][:, None].expand(-1, count, -1),
            encoded_places(points * (math.pi / window), _FREQUENCIES),
            encoded_places((2 * places - 1) * math.pi, _FREQUENCIES)[:, None].expand(-1, count, -1),
        ]
        inputs = torch.cat(each if features is None else [*each, features], -1)
        hidden = inputs
        for layer in self.hidden:
            hidden = rectified(layer, hidden)
        found = self.head(torch.cat([hidden, inputs], -1))
        return KernelRays(points + found[..., 2:4], _ORIGIN * found[..., :2], torch.softmax(found[..., 4], 1))
