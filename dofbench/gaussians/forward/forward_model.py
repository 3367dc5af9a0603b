"""What a forward model is, and what it may use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

from torch import Tensor

from dofbench.compute.raster import Geometry, Raster
from dofbench.core.cameras import Camera
from dofbench.core.lens import GAMMA
from dofbench.gaussians.forward.shot import Shot
from dofbench.gaussians.model import Gaussians
from dofbench.learning.rendered_surface import surface_disparity


@dataclass(frozen=True)
class BlurOptions:
    """Which forward model there is, and what all of them share."""

    lens_model: Literal["scatter", "samples"] = "scatter"
    """How the lens blurs: scatter spreads the pixels of the sharp rendering; samples rasterises the scene as seen from
    points of the lens, with the occlusion that comes with it. Unit: none. Source: scatter: Algorithm 1; samples:
    own."""
    lens_gamma: float = GAMMA
    """Exponent that makes linear light of encoded colours, in which blur is taken. Unit: none. Source: supplement; 2 in
    the released code."""
    blur_to_depth: bool = False
    """Whether the blur's gradient reaches the geometry. Unit: none. Source: off: released code; on: own."""


@dataclass(frozen=True, eq=False)
class SharpView:
    """What was rasterised of a view without a lens."""

    raster: Raster

    @cached_property
    def disparity(self) -> Tensor:
        """(H, W), 1 / scene unit, differentiable by depth; wants a raster with depth."""
        return surface_disparity(self.raster.depth, self.raster.alpha.detach())


class Rasteriser(Protocol):
    """How a forward model sees the Gaussians. In training it keeps statistics and gradients of all that it rasterises,
    in rendering it just rasterises."""

    gaussians: Gaussians

    def rasterise(
        self, camera: Camera, geometry: Geometry, *, means: Tensor | None = None, blur: Tensor | None = None
    ) -> Raster:
        """One sharp view, as `gaussians.render.rasterise` documents it."""

    def turn(self) -> float:
        """By how much a pattern of points of the lens is turned, radians: at random in training, 0 in rendering."""


class ForwardModel(Protocol):
    """Makes a photograph of the sharp view and of whatever else it rasterises.

    reads: what the sharp view must hold for it. rasterises: the geometry of its own rasterisations, which are compiled
    before training. stage: the part of a training step that its time and its bad numbers are counted to.
    """

    reads: Geometry
    rasterises: tuple[Geometry, ...]
    stage: str

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """(H, W, 3) encoded, as the shot's camera sees the scene through its lens; differentiable."""
