"""No lens: a pixel is what one ray sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torch import Tensor

from dofbench.training.fields.forward.ray_model import Prediction, RayScene
from dofbench.training.fields.pixels import Pixels, TrainingPixels


class PinholeRays:
    """A `RayModel` that explains every photograph as sharp."""

    stage = "rays"
    kernels: tuple[str, ...] = ()

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of all photographs."""
        return photographs.draw(count)

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """What the ray through each pixel's centre sees."""
        return [Prediction(scene.trace(*scene.cameras.rays(pixels.views, pixels.places)).color)]

    def cost(self, progress: float) -> Tensor | None:
        """None."""
        return None

    def gradients(self) -> Mapping[str, Tensor | None]:
        """Nothing."""
        return {}

    def step(self, progress: float) -> None:
        """There is nothing to update."""
