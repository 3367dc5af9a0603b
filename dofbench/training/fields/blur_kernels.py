"""What fields with learned blur kernels share: options, the schedule of the kernel, and its network's updates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor, nn

from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange
from dofbench.training.common.depth import all_disparities
from dofbench.training.common.networks import NetworkAdam
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.pixels import Pixels, TrainingPixels
from dofbench.training.fields.ray_model import Prediction, RayModel, RayTracer

_UNIT = 0.75  # of the nearest points' depth: Deblur-NeRF scales LLFF's scenes so that they are beyond 4 / 3


@dataclass(frozen=True)
class KernelOptions:
    """When a blur kernel is learned, and how fast."""

    kernel_points: int = 5
    """Rays that a pixel is mixed from. Unit: none. Source: Deblur-NeRF, DP-NeRF."""
    kernel_from: float = 0.006
    """When the kernel begins; before it a pixel is one ray. Unit: share of the training. Source: Deblur-NeRF, DP-NeRF,
    step 1200 of 200 000."""
    kernel_lr: float = 5e-4
    """Adam's learning rate of the kernel's network at the start. Unit: parameter, a step. Source: Deblur-NeRF."""
    kernel_lr_final: float = 0.16
    """Share of it that is left at the end; it falls exponentially. Unit: none. Source: Deblur-NeRF, 0.1^(200 / 250)."""

    def __post_init__(self) -> None:
        if self.kernel_points < 2:
            raise InputError("option kernel_points", str(self.kernel_points), "at least 2")


@dataclass(frozen=True)
class KernelFieldOptions(FieldOptions):
    """Options of a radiance field, and of its blur kernels."""

    kernel: KernelOptions = KernelOptions()


class LearnedKernel(RayModel, ABC):
    """Mixes each pixel from several rays, given by a network. parameters: the network's, with names."""

    stage = "kernel rays"
    kernels = ("tone",)

    def __init__(self, parameters: Iterable[tuple[str, nn.Parameter]], options: KernelOptions):
        self._options = options
        self._adam = NetworkAdam(parameters, options.kernel_lr, options.kernel_lr_final)

    @property
    def rays_per_pixel(self) -> int:
        """Rays that a pixel takes once the kernel has begun."""
        return self._options.kernel_points

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        begun = progress >= self._options.kernel_from
        return photographs.draw(max(1, count // self.rays_per_pixel) if begun else count)

    def predict(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        if progress < self._options.kernel_from:
            return super().predict(tracer, pixels, progress)
        return self.mix(tracer, pixels, progress)

    @abstractmethod
    def mix(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """Predict pixels by the kernel."""

    def gradients(self) -> Mapping[str, Tensor | None]:
        return self._adam.gradients()

    def step(self, progress: float) -> None:
        self._adam.step(progress)


def unit_of_depth(training_set: TrainingSet) -> float:
    """The depth, scene units, that counts as 1 for kernels."""
    assert training_set.points is not None
    cameras = [view.camera for view in training_set.views]
    return _UNIT / DisparityRange.of_disparity(all_disparities(training_set.points, cameras)).q_max
