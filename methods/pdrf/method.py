"""PDRF (Peng and Chellappa, AAAI 2023): progressive blur estimation (section 3.2). A deformable sparse kernel is
proposed from the pixel alone, and again from what the rays of the first proposal met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dofbench.core.contracts import TrainingSet
from dofbench.methods.deblurnerf.method import KernelNetwork, KernelRays
from dofbench.training.common.networks import redraw
from dofbench.training.fields.blur_kernels import KernelFieldOptions, KernelOptions, LearnedKernel, unit_of_depth
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.pixels import Pixels
from dofbench.training.fields.ray_model import Prediction, RayModel, RayTracer, mixed

_FEATURES = 15  # inputs of the second proposal about each ray
_NOISE = 0.15  # px: standard deviation of noise on the canonical points


@dataclass(frozen=True)
class ProgressiveOptions(KernelOptions):
    """The options of learned kernels, with PDRF's values."""

    kernel_points: int = 10
    """Rays that a pixel is mixed from. Unit: none. Source: PDRF."""
    kernel_from: float = 0.04
    """When the kernel begins; before it a pixel is one ray. Unit: share of the training. Source: PDRF, step 1200 of
    30 000."""
    kernel_lr: float = 1e-3
    """Adam's learning rate of the kernel's network at the start. Unit: parameter, a step. Source: PDRF."""
    kernel_lr_final: float = 1e-3
    """Share of it that is left at the end; it falls exponentially. Unit: none. Source: PDRF, 0.1^(30 / 10)."""
    kernel_window: float = 10.0
    """How far from the pixel the canonical points of a kernel can lie. Unit: px. Source: PDRF."""


class ProgressiveKernel(LearnedKernel):
    """Mixes pixels by two proposals of one kernel network; a pixel's first ray is its own in both.

    unit: as for `DeformableKernel`. channels: of the field's features at a point (`GridOptions.feature_count`), from
    which a layer makes the inputs of the second proposal. PDRF blends features over the samples of a ray of a coarse
    field; here they are those of the one field, where the ray meets something on average.
    """

    _options: ProgressiveOptions

    def __init__(
        self,
        views: int,
        unit: float,
        channels: int,
        options: ProgressiveOptions,
        generator: torch.Generator,
        device: torch.device | str = "cpu",
    ):
        self._unit, self._generator = unit, generator
        self._network = _ProgressiveNetwork(views, options.kernel_points, channels, generator).to(device)
        super().__init__(self._network.named_parameters(), options)

    @property
    def rays_per_pixel(self) -> int:
        return 2 * self._options.kernel_points

    def mix(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The second proposal's mixture, and the mean of both."""
        empty = pixels.places.new_zeros(len(pixels.views), self._options.kernel_points, _FEATURES)
        proposed = self._propose(tracer, pixels, empty)
        origins, directions = proposed.in_world(tracer, pixels, self._unit)
        seen = tracer.trace(origins, directions)
        first = mixed(seen.color.view(*proposed.weights.shape, 3), proposed.weights)
        met = self._network.told(tracer.scene.features_met(origins, directions, seen)).view(empty.shape)
        again = self._propose(tracer, pixels, met)
        seen = tracer.trace(*again.in_world(tracer, pixels, self._unit))
        second = mixed(seen.color.view(*again.weights.shape, 3), again.weights)
        return [Prediction(second), Prediction((first + second) / 2)]

    def _propose(self, tracer: RayTracer, pixels: Pixels, told: Tensor) -> KernelRays:
        points = self._network.kernel.canonical(pixels.views) * self._options.kernel_window
        noise = torch.randn(points.shape, generator=self._generator).to(points.device, non_blocking=True)
        points = points + noise * _NOISE
        across = pixels.places / tracer.cameras.sizes[pixels.views]
        found = self._network.kernel(pixels.views, points, across, self._options.kernel_window, told)
        others = (torch.arange(points.shape[1], device=points.device) > 0).to(points.dtype)[:, None]
        return KernelRays(others * found.places, others * found.origins, found.weights)


class _ProgressiveNetwork(nn.Module):
    """The kernel's network, which both proposals share, and the layer that sums up what a ray met."""

    def __init__(self, views: int, points: int, channels: int, generator: torch.Generator):
        super().__init__()
        self.told = nn.Linear(channels, _FEATURES)
        redraw(self.told, generator)
        self.kernel = KernelNetwork(views, points, generator, _FEATURES)


@dataclass(frozen=True)
class ProgressiveFieldOptions(KernelFieldOptions):
    """Options of a field with progressively estimated kernels."""

    kernel: ProgressiveOptions = ProgressiveOptions()


class PDRF(FieldMethod):
    """A field without a lens; in training, pixels are mixed by a kernel estimated in two stages."""

    OPTIONS = ProgressiveFieldOptions

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        options = self._options
        assert isinstance(options, ProgressiveFieldOptions)
        views, unit = len(training_set.views), unit_of_depth(training_set)
        return ProgressiveKernel(views, unit, options.grid.feature_count, options.kernel, generator, self._device)
