"""The interface of a forward model of rays: what training views show at pixels, from what their rays see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.lens import GAMMA
from dofbench.optics.tone import fast_decode, fast_encode
from dofbench.training.fields.cube_rays import RaysSeen
from dofbench.training.fields.field_scene import FieldScene
from dofbench.training.fields.pixels import CameraTable, Pixels, TrainingPixels


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted pixels. colours: (P, 3), encoded. weight: of their mean squared error in the loss."""

    colours: Tensor
    weight: float = 1.0


RAYS_AT_ONCE = 8192  # of a prediction without gradient


class RayTracer:
    """Traces rays in training. cameras: of the training views. generator: the host's, so that rays are sampled at the
    same places on every device."""

    def __init__(self, scene: FieldScene, cameras: CameraTable, generator: torch.Generator):
        self.scene, self.cameras, self._generator = scene, cameras, generator

    def trace(self, origins: Tensor, directions: Tensor) -> RaysSeen:
        """Trace world rays (R, 3) of length 1 in z of their camera, sampled at random places; differentiable."""
        offsets = torch.rand(len(origins), generator=self._generator).to(origins.device, non_blocking=True)
        return self.scene.see(origins, directions, offsets)


class RayModel:
    """Predicts pixels of the training views; by itself without a lens, by one ray a pixel.

    stage: the name of its time. kernels: ops that it calls besides `field`, compiled before training starts.
    """

    stage = "rays"
    kernels: tuple[str, ...] = ()

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Draw the pixels of a step at `progress`, 0 to 1, of about `count` rays in all."""
        return photographs.draw(count)

    def predict(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """Predict these pixels, in one way or several."""
        return [Prediction(tracer.trace(*tracer.cameras.rays(pixels.views, pixels.places)).color)]

    @property
    def rays_per_pixel(self) -> int:
        """The most rays that `predict` traces for a pixel."""
        return 1

    @torch.no_grad()
    def predict_view(self, tracer: RayTracer, pixels: Pixels, asked: Tensor) -> Tensor:
        """(P, 3), encoded: predict a view as at the end of training; of several ways the one of the largest weight.

        pixels: all P of the view, as a patch. asked: (P,) bool, the pixels to predict; others are 0.
        """
        colours = torch.zeros_like(pixels.colours)
        for part in asked.nonzero()[:, 0].split(max(1, RAYS_AT_ONCE // self.rays_per_pixel)):
            ways = self.predict(tracer, pixels.at(part), 1.0)
            colours[part] = max(ways, key=lambda way: way.weight).colours
        return colours

    def cost(self, progress: float) -> Tensor | None:
        """Return the model's own term of the loss, after `predict`; None for none."""
        return None

    def gradients(self) -> Mapping[str, Tensor | None]:
        """Gradients of what the model learns, by name; None for what the step didn't use."""
        return {}

    def step(self, progress: float) -> None:
        """Update what the model learns by its gradients, which are then dropped."""


def mixed(colours: Tensor, weights: Tensor) -> Tensor:
    """(P, 3) encoded: mix colours (P, N, 3), encoded, by weights (P, N) in linear light (Deblur-NeRF, Eq. 5 and 6)."""
    light = fast_decode(colours.contiguous(), GAMMA)
    return fast_encode((weights[..., None] * light).sum(1), GAMMA)
