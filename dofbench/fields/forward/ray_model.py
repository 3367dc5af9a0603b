"""What a forward model of rays is, and what it renders with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor

from dofbench.compute.factored_grid import FieldRender
from dofbench.fields.field_scene import FieldScene
from dofbench.fields.pixels import CameraTable, Pixels


class RayScene:
    """The field as a forward model sees it in training. cameras: those of the training views."""

    def __init__(self, scene: FieldScene, cameras: CameraTable, generator: torch.Generator):
        self.cameras = cameras
        self._scene, self._generator = scene, generator

    def trace(self, origins: Tensor, directions: Tensor) -> FieldRender:
        """What world rays (R, 3) see, whose directions have the length 1 in z of their camera; differentiable. Each is
        sampled at random places of its steps."""
        return self._scene.see(origins, directions, torch.rand(len(origins), generator=self._generator))


class RayModel(Protocol):
    """How pixels of photographs come about. stage: what the time that it takes is called."""

    stage: str

    def colours(self, scene: RayScene, pixels: Pixels, progress: float) -> Tensor:
        """(P, 3), encoded: the colours that the photographs would have at these pixels, at `progress`, 0 to 1."""

    def learned(self) -> Mapping[str, Tensor]:
        """The tensors that are learned beside the field, by name."""

    def step(self, progress: float) -> None:
        """Update what is learned by its gradients, which are then dropped."""
