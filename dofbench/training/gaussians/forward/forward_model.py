"""The interface of a forward model, and of the rasteriser that it uses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.lens import GAMMA
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.raster import Geometry, Raster
from dofbench.training.common.rendered_surface import surface_disparity
from dofbench.training.common.training_views import Photograph
from dofbench.training.gaussians.forward.shot import Shot
from dofbench.training.gaussians.model import Gaussians


@dataclass(frozen=True)
class BlurOptions:
    """Which forward model is used, and the options that all forward models share."""

    lens_model: Literal["scatter", "samples"] = "scatter"
    """How the lens blurs: scatter spreads the pixels of the sharp rendering; samples rasterises the scene as seen from
    points of the lens, with the occlusion that comes with it. Unit: none. Source: scatter: Algorithm 1; samples:
    own."""
    lens_gamma: float = GAMMA
    """Exponent that turns encoded colours into linear light, in which the blur is computed. Unit: none. Source:
    supplement; 2 in the released code."""
    blur_to_depth: bool = False
    """Whether the blur's gradient reaches the geometry. Unit: none. Source: off: released code; on: own."""


class SharpView:
    """A view rasterised without a lens, when it is looked at for the first time.

    make: rasterises it.
    """

    def __init__(self, make: Callable[[], Raster]):
        self._make = make

    @cached_property
    def raster(self) -> Raster:
        """The rasterised view."""
        return self._make()

    @cached_property
    def disparity(self) -> Tensor:
        """(H, W), 1 / scene unit, differentiable with respect to depth; needs a raster with depth."""
        assert self.raster.depth is not None
        return surface_disparity(self.raster.depth, self.raster.alpha.detach())


class Rasteriser(Protocol):
    """Rasterises the Gaussians for a forward model. The rasteriser used in training also keeps statistics and gradients
    of everything that it rasterises."""

    gaussians: Gaussians

    def rasterise(self, camera: Camera, geometry: Geometry) -> Raster:
        """One sharp view; arguments as in `gaussians.render.rasterise`."""

    def changed(self, camera: Camera, parameters: Mapping[str, Tensor]) -> Tensor:
        """(H, W, 3): a view of the scene with some of the Gaussians' parameters replaced, by name. Gradients reach
        these, and the Gaussians' own parameters where the new ones are computed from them."""

    def from_points(self, camera: Camera, points: np.ndarray, radius: Tensor, blur: Tensor) -> Tensor:
        """(P, H, W, 3) as seen from points of the lens; arguments as in `gaussians.render.rasterise_from_points`."""

    def turn(self) -> float:
        """Angle by which the pattern of lens points is rotated, radians: random in training, 0 in rendering."""


class ForwardModel(Protocol):
    """Makes a photograph from the sharp view and, if it needs more, from rasterisations of its own.

    reads: the geometry that it needs of the sharp view. looks: whether it looks at the sharp view at all. from_points:
    whether it rasterises the scene from points of the lens. stage: the part of a training step under which its time and
    its non-finite values are reported.
    """

    reads: Geometry
    looks: bool
    from_points: bool
    stage: str

    def photograph(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """(H, W, 3) encoded, as the shot's camera sees the scene through its lens; differentiable."""

    def cost(self, sharp: SharpView, shot: Shot, view: Photograph) -> Tensor | None:
        """A term of the loss that belongs to the model, for the photograph just made; None for none. view: the real
        photograph."""


class WithoutCost:
    """Part of a `ForwardModel` that adds nothing to the loss."""

    def cost(self, sharp: SharpView, shot: Shot, view: Photograph) -> Tensor | None:
        """None."""
        return None


@dataclass(frozen=True, eq=False)
class BlurStart:
    """What learned blur begins with.

    gaussians: the first ones. cameras: those of the photographs. extent: of the scene, scene units,
    `model.scene_extent`. generator: for all that the blur draws.
    """

    gaussians: Gaussians
    cameras: Sequence[Camera]
    extent: float
    generator: torch.Generator

    @property
    def means(self) -> Tensor:
        """(N, 3) the Gaussians' means, scene units, without gradient."""
        return self.gaussians.parameters["means"].detach()

    @property
    def device(self) -> torch.device:
        """Where the Gaussians lie."""
        return self.means.device

    @property
    def place(self) -> Tensor:
        """(3,) the mean of the cameras' places, scene units."""
        return beside(self.means, np.mean([camera.centre for camera in self.cameras], axis=0))


class LearnedBlur(Protocol):
    """Blur that is learned with the scene and isn't a lens: it explains the training photographs, and is left out when
    the scene is rendered. kernels: ops that it calls beside `rasterize`."""

    kernels: tuple[str, ...]

    def models(self) -> Sequence[tuple[float, ForwardModel]]:
        """The forward models of the training, each with the share of it from which it is used; the first starts at
        0."""

    def gradient(self) -> Tensor | None:
        """All gradients of the last step in one row, for a check; None if there are none."""

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """Learn from a step on photograph number `view` at `progress`, 0 to 1. cooldown: a factor on the rates."""
