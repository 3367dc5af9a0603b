"""Deblur-NeRF's deformable sparse kernel (Ma et al., CVPR 2022, section 4.2): a pixel is mixed from a few rays beside
it, whose places and weights a network gives for each photograph and pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.fields.forward.blur_kernels import KernelOptions
from dofbench.fields.forward.mixed_rays import mixed
from dofbench.fields.forward.ray_model import RayScene
from dofbench.fields.pixels import Pixels, TrainingPixels
from dofbench.learning.networks import NetworkAdam, encoded_places, redraw

_EMBEDDING, _WIDTH, _HIDDEN, _FREQUENCIES = 32, 64, 4, 2
_FIRST_SPREAD = 0.1  # standard deviation of the canonical points' parameters at the start
_ORIGIN = 0.01  # of the unit of depth: what the network's origins are multiplied by
_ALIGN_ORIGIN = 10.0  # weight of the origin against the place in the alignment


@dataclass(frozen=True)
class DeformableOptions:
    """The deformable sparse kernel's own options."""

    kernel_window: float = 10.0
    """How far from the pixel the canonical points of a kernel can lie. Unit: px. Source: Deblur-NeRF."""
    kernel_noise: float = 0.15
    """Standard deviation of noise on the canonical points in training. Unit: px. Source: Deblur-NeRF."""
    align_weight: float = 0.1
    """Weight of the term that keeps a kernel's first ray at its pixel. Unit: none. Source: Deblur-NeRF."""
    align_until: float = 0.9
    """When this term ends. Unit: share of the training. Source: Deblur-NeRF, step 180 000 of 200 000."""


class DeformableKernel:
    """A `RayModel`. unit: the depth, scene units, that counts as 1: origins move by hundredths of it, and rays still
    pass through the same point there."""

    stage = "kernel rays"
    kernels: tuple[str, ...] = ("tone",)

    def __init__(
        self, views: int, unit: float, options: KernelOptions, own: DeformableOptions, generator: torch.Generator
    ):
        self._unit, self._options, self._own, self._generator = unit, options, own, generator
        self._network = _KernelNetwork(views, options.kernel_points, generator)
        self._adam = NetworkAdam(self._network.named_parameters(), options.kernel_lr, options.kernel_lr_final)
        self._cost: Tensor | None = None

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of all photographs, fewer by the number of rays that each is mixed from."""
        return photographs.draw(count if progress < self._options.kernel_from else count // self._options.kernel_points)

    def colours(self, scene: RayScene, pixels: Pixels, progress: float) -> Tensor:
        """The mixture of what the kernel's rays see."""
        self._cost = None
        if progress < self._options.kernel_from:
            return scene.trace(*scene.cameras.rays(pixels.views, pixels.places)).color
        points = self._network.canonical(pixels.views) * self._own.kernel_window
        noise = torch.randn(points.shape, generator=self._generator) * self._own.kernel_noise
        across = pixels.places / scene.cameras.sizes[pixels.views]
        moved, origins, logits = self._network(pixels.views, points + noise, across, self._own.kernel_window)
        places, shift = points + noise + moved, _ORIGIN * self._unit * origins
        count = places.shape[1]
        seen = scene.trace(
            *scene.cameras.rays(
                pixels.views.repeat_interleave(count),
                (pixels.places[:, None] + places).reshape(-1, 2),
                shift.reshape(-1, 2),
                -shift.reshape(-1, 2) / self._unit,
            )
        )
        first = points[:, 0] + moved[:, 0]
        self._cost = first.abs().mean() + _ALIGN_ORIGIN * (_ORIGIN * origins[:, 0]).abs().mean()
        return mixed(seen.color.view(-1, count, 3), torch.softmax(logits, 1))

    def cost(self, progress: float) -> Tensor | None:
        """How far a kernel's first ray is from its pixel's own."""
        if self._cost is None or progress >= self._own.align_until:
            return None
        return self._own.align_weight * self._cost

    def gradients(self) -> Mapping[str, Tensor | None]:
        """Those of the network's parameters."""
        return self._adam.gradients()

    def step(self, progress: float) -> None:
        """An Adam step on the network."""
        self._adam.step(progress)


class _KernelNetwork(nn.Module):
    """From a photograph, a pixel and a canonical point to the point's move, its ray's origin and its weight."""

    def __init__(self, views: int, points: int, generator: torch.Generator):
        super().__init__()
        self.pattern = nn.Parameter(_FIRST_SPREAD * torch.randn(views, points, 2, generator=generator))
        self.embedding = nn.Parameter(torch.zeros(views, _EMBEDDING))
        inputs = _EMBEDDING + 4 * (1 + 2 * _FREQUENCIES)
        widths = [inputs, *[_WIDTH] * _HIDDEN]
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.head = nn.Linear(_WIDTH + inputs, 5)
        redraw(self, generator)

    def canonical(self, views: Tensor) -> Tensor:
        """(P, N, 2) canonical points of the pixels' photographs, each coordinate from -1 to 1."""
        return torch.tanh(self.pattern[views])

    def forward(self, views: Tensor, points: Tensor, places: Tensor, window: float) -> tuple[Tensor, Tensor, Tensor]:
        """(moves (P, N, 2), pixels; origins (P, N, 2); logits of the weights (P, N)). points: (P, N, 2), and
        window, pixels. places: (P, 2), 0 to 1 across the photograph."""
        count = points.shape[1]
        each = [
            self.embedding[views][:, None].expand(-1, count, -1),
            encoded_places(points * (math.pi / window), _FREQUENCIES),
            encoded_places((2 * places - 1) * math.pi, _FREQUENCIES)[:, None].expand(-1, count, -1),
        ]
        inputs = torch.cat(each, -1)
        features = inputs
        for layer in self.hidden:
            features = torch.relu(layer(features))
        found = self.head(torch.cat([features, inputs], -1))
        return found[..., 2:4], found[..., :2], found[..., 4]
