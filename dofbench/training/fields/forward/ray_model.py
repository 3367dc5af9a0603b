"""What a forward model of rays is, and what it renders with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from dofbench.training.fields.field_scene import FieldScene
from dofbench.training.fields.pixels import CameraTable, Pixels, TrainingPixels
from dofbench.training.fields.rays_seen import RaysSeen


@dataclass(frozen=True, eq=False)
class Prediction:
    """What photographs show, according to a model. colours: (P, 3), encoded. weight: of its mean squared error in the
    loss."""

    colours: Tensor
    weight: float = 1.0


class RayScene:
    """The field as a forward model sees it in training. cameras: those of the training views. generator: the host's, so
    that rays are sampled at the same places on every device."""

    def __init__(self, scene: FieldScene, cameras: CameraTable, generator: torch.Generator):
        self.cameras = cameras
        self._scene, self._generator = scene, generator

    def trace(self, origins: Tensor, directions: Tensor) -> RaysSeen:
        """What world rays (R, 3) see, whose directions have the length 1 in z of their camera; differentiable. Each is
        sampled at random places of its steps."""
        offsets = torch.rand(len(origins), generator=self._generator).to(origins.device, non_blocking=True)
        return self._scene.see(origins, directions, offsets)

    def disparity(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R,) 1 / z in the cameras' frames, 1 / scene unit, of the mean place of what `trace` found; differentiable.
        Rays that met nothing count as if they had met something at their end."""
        return self._scene.disparity(origins, directions, seen)

    def features_met(self, origins: Tensor, directions: Tensor, seen: RaysSeen) -> Tensor:
        """(R, C) what the field stores (`GridField.features`) at the mean place of what `trace` found; differentiable
        by the field alone, not by the rays."""
        return self._scene.features_met(origins, directions, seen)

    def features_along(self, origins: Tensor, directions: Tensor, count: int) -> Tensor:
        """(R, count, C) the same in the middle of each of `count` equal parts of the rays."""
        return self._scene.features_along(origins, directions, count)


class RayModel(Protocol):
    """How pixels of photographs come about. stage: what the time that it takes is called. kernels: the ops that it
    calls beside `field`, which are compiled before the training's clock starts."""

    stage: str
    kernels: tuple[str, ...]

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """The pixels of a training step at `progress`, 0 to 1: about `count` rays' worth of them, as the model needs
        them."""

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """What the photographs would show at these pixels; a model may say it in more than one way."""

    def cost(self, progress: float) -> Tensor | None:
        """A term of the loss about what is learned beside the field, after `predict`; None for no such term."""

    def gradients(self) -> Mapping[str, Tensor | None]:
        """Gradients of what is learned beside the field, by name; None for what the step didn't use."""

    def step(self, progress: float) -> None:
        """Update what is learned by its gradients, which are then dropped."""
