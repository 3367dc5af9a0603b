"""Deblur-NeRF's deformable sparse kernel (Ma et al., CVPR 2022, section 4.2): a pixel is mixed from a few rays beside
it, whose places and weights a network gives for each photograph and pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.training.fields.forward.blur_kernels import KernelOptions, LearnedKernel
from dofbench.training.fields.forward.kernel_network import KernelNetwork
from dofbench.training.fields.forward.mixed_rays import mixed
from dofbench.training.fields.forward.ray_model import Prediction, RayScene
from dofbench.training.fields.pixels import Pixels, TrainingPixels

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


class DeformableKernel(LearnedKernel):
    """A `RayModel`. unit: the depth, scene units, that counts as 1: origins move by hundredths of it, and rays still
    pass through the same point there."""

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

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of all photographs, fewer by the number of rays that each is mixed from."""
        return photographs.draw(count if progress < self._options.kernel_from else count // self._options.kernel_points)

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The mixture of what the kernel's rays see."""
        self._cost = None
        if progress < self._options.kernel_from:
            return [Prediction(scene.trace(*scene.cameras.rays(pixels.views, pixels.places)).color)]
        points = self._network.canonical(pixels.views) * self._own.kernel_window
        noise = torch.randn(points.shape, generator=self._generator).to(points.device, non_blocking=True)
        noise = noise * self._own.kernel_noise
        across = pixels.places / scene.cameras.sizes[pixels.views]
        rays = self._network(pixels.views, points + noise, across, self._own.kernel_window)
        seen = scene.trace(*rays.in_world(scene, pixels, self._unit))
        first = rays.places[:, 0] - noise[:, 0]
        self._cost = first.abs().mean() + _ALIGN_ORIGIN * rays.origins[:, 0].abs().mean()
        return [Prediction(mixed(seen.color.view(*rays.weights.shape, 3), rays.weights))]

    def cost(self, progress: float) -> Tensor | None:
        """How far a kernel's first ray is from its pixel's own."""
        if self._cost is None or progress >= self._own.align_until:
            return None
        return self._own.align_weight * self._cost
