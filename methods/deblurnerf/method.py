"""Deblur-NeRF (Ma et al., CVPR 2022): a deformable sparse kernel (section 4.2). A pixel is mixed from a few rays next
to it; a network gives their places and weights for each view and pixel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from dofbench.core.contracts import TrainingSet
from dofbench.training.common.networks import encoded_places, rectified, redraw
from dofbench.training.fields.blur_kernels import KernelFieldOptions, KernelOptions, LearnedKernel, unit_of_depth
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.pixels import Pixels
from dofbench.training.fields.ray_model import Prediction, RayModel, RayTracer, mixed

_EMBEDDING, _WIDTH, _HIDDEN, _FREQUENCIES = 32, 64, 4, 2
_FIRST_SPREAD = 0.1  # standard deviation of the canonical points' parameters at the start
_ORIGIN = 0.01  # of the unit of depth: the factor on the network's origins
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


@dataclass(frozen=True, eq=False)
class KernelRays:
    """The N rays that each of P pixels is mixed from. places: (P, N, 2), from the pixel, px. origins: (P, N, 2), from
    the camera's centre, units of depth. weights: (P, N), with sum 1 for a pixel."""

    places: Tensor
    origins: Tensor
    weights: Tensor

    def in_world(self, tracer: RayTracer, pixels: Pixels, unit: float) -> tuple[Tensor, Tensor]:
        """(P N, 3) origins and directions. unit: the depth, scene units, that counts as 1; there a moved ray still
        passes through its place."""
        shift = unit * self.origins
        return tracer.cameras.rays(
            pixels.views.repeat_interleave(self.places.shape[1]),
            (pixels.places[:, None] + self.places).reshape(-1, 2),
            shift.reshape(-1, 2),
            -shift.reshape(-1, 2) / unit,
        )


class KernelNetwork(nn.Module):
    """From a view, a pixel and a canonical point to the point's move, its ray's origin and its weight.

    points: rays a pixel. features: numbers about each ray that are further inputs.
    """

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
        """(P, N, 2) canonical points of the pixels' views, each coordinate from -1 to 1."""
        return torch.tanh(self.pattern[views])

    def forward(
        self, views: Tensor, points: Tensor, places: Tensor, window: float, features: Tensor | None = None
    ) -> KernelRays:
        """Propose the rays. points: (P, N, 2), and window, px. places: (P, 2), 0 to 1 across the view. features:
        (P, N, F) or None."""
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


class DeformableKernel(LearnedKernel):
    """Mixes pixels by the kernel network. unit: the depth, scene units, that counts as 1: origins move by hundredths of
    it, and rays still pass through the same point there."""

    def __init__(
        self,
        views: int,
        unit: float,
        options: KernelOptions,
        own: DeformableOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._unit, self._own, self._generator = unit, own, generator
        self._network = KernelNetwork(views, options.kernel_points, generator).to(device)
        super().__init__(self._network.named_parameters(), options)
        self._cost: Tensor | None = None

    def mix(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        points = self._network.canonical(pixels.views) * self._own.kernel_window
        noise = torch.randn(points.shape, generator=self._generator).to(points.device, non_blocking=True)
        noise = noise * self._own.kernel_noise
        across = pixels.places / tracer.cameras.sizes[pixels.views]
        rays = self._network(pixels.views, points + noise, across, self._own.kernel_window)
        seen = tracer.trace(*rays.in_world(tracer, pixels, self._unit))
        first = rays.places[:, 0] - noise[:, 0]
        self._cost = first.abs().mean() + _ALIGN_ORIGIN * rays.origins[:, 0].abs().mean()
        return [Prediction(mixed(seen.color.view(*rays.weights.shape, 3), rays.weights))]

    def cost(self, progress: float) -> Tensor | None:
        """The weighted distance of a kernel's first ray from its pixel's own."""
        if self._cost is None or progress >= self._own.align_until:
            return None
        return self._own.align_weight * self._cost


@dataclass(frozen=True)
class DeformableFieldOptions(KernelFieldOptions):
    """Options of a field with deformable sparse kernels."""

    deformable: DeformableOptions = DeformableOptions()


class DeblurNeRF(FieldMethod):
    """A field without a lens; in training, pixels are mixed by the deformable sparse kernel."""

    OPTIONS = DeformableFieldOptions

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        options = self._options
        assert isinstance(options, DeformableFieldOptions)
        views, unit = len(training_set.views), unit_of_depth(training_set)
        return DeformableKernel(views, unit, options.kernel, options.deformable, generator, self._device)
