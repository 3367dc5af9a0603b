"""No lens: a pixel is what one ray sees."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from dofbench.fields.forward.ray_model import RayScene
from dofbench.fields.pixels import Pixels


class PinholeRays:
    """A `RayModel` that explains every photograph as sharp."""

    stage = "rays"

    def colours(self, scene: RayScene, pixels: Pixels, progress: float) -> Tensor:
        """What the ray through each pixel's centre sees."""
        return scene.trace(*scene.cameras.rays(pixels.views, pixels.places)).color

    def learned(self) -> Mapping[str, Tensor]:
        """Nothing."""
        return {}

    def step(self, progress: float) -> None:
        """There is nothing to update."""
