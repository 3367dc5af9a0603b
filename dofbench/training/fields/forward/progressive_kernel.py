"""PDRF's progressive blur estimation (Peng and Chellappa, AAAI 2023, section 3.2): a deformable sparse kernel is
proposed from the pixel alone, and proposed again from what the rays of the first proposal met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from dofbench.training.common.networks import redraw
from dofbench.training.fields.forward.blur_kernels import KernelOptions, LearnedKernel
from dofbench.training.fields.forward.kernel_network import KernelNetwork, KernelRays
from dofbench.training.fields.forward.mixed_rays import mixed
from dofbench.training.fields.forward.ray_model import Prediction, RayScene
from dofbench.training.fields.pixels import Pixels, TrainingPixels

_FEATURES = 15  # numbers that the second proposal is told about each ray
_NOISE = 0.15  # px: standard deviation of noise on them


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
    """A `RayModel`. unit: the depth, scene units, that counts as 1, as for `DeformableKernel`. channels: what the field
    stores at a point (`GridOptions.feature_count`), of which a layer makes what the second proposal is told.

    A pixel's first ray is its own in both proposals. PDRF blends features over the samples of a ray of a coarse field;
    here they are those of the one field, where the ray meets something on average.
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

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of all photographs, fewer by the number of rays that each is mixed from, twice."""
        return photographs.draw(
            count if progress < self._options.kernel_from else max(1, count // (2 * self._options.kernel_points))
        )

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The second proposal's mixture, and the mean of both."""
        if progress < self._options.kernel_from:
            return [Prediction(scene.trace(*scene.cameras.rays(pixels.views, pixels.places)).color)]
        empty = pixels.places.new_zeros(len(pixels.views), self._options.kernel_points, _FEATURES)
        proposed = self._proposed(scene, pixels, empty)
        rays = proposed.in_world(scene, pixels, self._unit)
        seen = scene.trace(*rays)
        first = mixed(seen.color.view(*proposed.weights.shape, 3), proposed.weights)
        met = self._network.told(scene.features_met(*rays, seen)).view(empty.shape)
        again = self._proposed(scene, pixels, met)
        seen = scene.trace(*again.in_world(scene, pixels, self._unit))
        second = mixed(seen.color.view(*again.weights.shape, 3), again.weights)
        return [Prediction(second), Prediction((first + second) / 2)]

    def _proposed(self, scene: RayScene, pixels: Pixels, told: Tensor) -> KernelRays:
        points = self._network.kernel.canonical(pixels.views) * self._options.kernel_window
        noise = torch.randn(points.shape, generator=self._generator).to(points.device, non_blocking=True)
        points = points + noise * _NOISE
        across = pixels.places / scene.cameras.sizes[pixels.views]
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
