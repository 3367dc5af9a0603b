"""The interface of a forward model: a camera and a lens in, an image with depth of field out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.lens import COC_FRACTION, GAMMA, DisparityRange, PhysicalLens
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.ops import load
from dofbench.runtime.raster import Geometry, Raster
from dofbench.training.common.depth import surface_disparity
from dofbench.training.common.networks import NetworkAdam
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.model import Gaussians

_CLIPPED = 1e-5, 1.0  # released code
_FREE = -math.inf, math.inf


@dataclass(frozen=True)
class BlurOptions:
    """Which forward model is used, and the options that all forward models share."""

    lens_model: Literal["scatter", "samples"] = "scatter"
    """How the lens blurs: scatter spreads the pixels of the sharp rendering; samples rasterises the scene as seen from
    aperture samples, with the occlusion that comes with it. Unit: none. Source: scatter: Algorithm 1; samples:
    own."""
    lens_gamma: float = GAMMA
    """Exponent that turns encoded colours into linear light, in which the blur is computed. Unit: none. Source:
    supplement; 2 in the released code."""
    blur_to_depth: bool = False
    """Whether the blur's gradient reaches the geometry. Unit: none. Source: off: released code; on: own."""


@dataclass(frozen=True, eq=False)
class Shot:
    """Camera and lens of one image.

    slope, offset: the signed CoC radius is slope * d + offset, units of 2 % of the width, at normalised disparity d;
    tensors in training, numbers in rendering. bounds: the disparities of d = 0 and 1. narrowed: Eq. 11's factor on the
    aperture by `out_of_focus`, or None. clipped: whether d is clipped to 1e-5 ... 1 (released code), without gradient
    beyond. number: of the training view, None for a rendering.
    """

    camera: Camera
    bounds: DisparityRange
    slope: Tensor | float
    offset: Tensor | float
    narrowed: Callable[[Tensor], Tensor] | None = None
    clipped: bool = False
    number: int | None = None

    @staticmethod
    def through(lens: PhysicalLens, camera: Camera) -> Shot:
        """A camera with a lens known in scene units."""
        slope = lens.aperture / (COC_FRACTION * lens.width)
        return Shot(camera, DisparityRange(0.0, 1.0), slope, -slope * lens.focus_disparity)

    def radius(self, disparity: Tensor) -> Tensor:
        """Signed CoC radii, px, of disparities (1 / scene unit)."""
        radius = self._whole(disparity)
        return radius if self.narrowed is None else radius * self.narrowed(self.out_of_focus(disparity))

    @torch.no_grad()
    def circles(self, disparity: Tensor) -> Tensor:
        """CoC radii, px, of disparities (1 / scene unit), with the aperture not narrowed."""
        return self._whole(disparity).abs()

    def out_of_focus(self, disparity: Tensor) -> Tensor:
        """|normalised disparity - focus|, without gradient."""
        slope, offset = (
            value.detach().to(disparity) if isinstance(value, Tensor) else beside(disparity, value)
            for value in (self.slope, self.offset)
        )
        focus = torch.where(slope == 0, 0.0, -offset / slope)
        normalised: Tensor = self.bounds.normalise(disparity.detach()).clamp(*self._limits)
        return (normalised - focus).abs()

    def _whole(self, disparity: Tensor) -> Tensor:
        radius: Tensor = load("surface", function="circle")(
            disparity,
            self.slope,
            self.offset,
            low=self.bounds.q_min,
            extent=self.bounds.extent,
            scale=COC_FRACTION * self.camera.width,
            clipped=self._limits,
        )
        return radius

    @property
    def _limits(self) -> tuple[float, float]:
        return _CLIPPED if self.clipped else _FREE


class SharpView:
    """A view without a lens, rasterised by `make` on first use."""

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
    """Rasterises the Gaussians for a forward model; in training it also keeps statistics and gradients."""

    gaussians: Gaussians

    def rasterise(self, camera: Camera, geometry: Geometry) -> Raster:
        """Rasterise one sharp view; arguments as in `gaussians.render.rasterise`."""

    def rasterise_with(self, camera: Camera, parameters: Mapping[str, Tensor]) -> Tensor:
        """(H, W, 3): rasterise a view with some parameters of the Gaussians replaced, by name; differentiable."""

    def rasterise_from_points(self, camera: Camera, points: np.ndarray, radius: Tensor, blur: Tensor) -> Tensor:
        """(P, H, W, 3) from aperture samples; arguments as in `gaussians.render.rasterise_from_points`."""

    def turn(self) -> float:
        """Return the rotation of the aperture samples, radians: random in training, 0 in rendering."""


class ForwardModel:
    """Makes an image from the sharp view and, if needed, from rasterisations of its own.

    reads: the geometry that it needs of the sharp view. needs_sharp_render: whether it uses the sharp view at all.
    samples_aperture: whether it rasterises from aperture samples. stage: the part of a training step under which its
    time and its non-finite values are reported.
    """

    reads: Geometry = "none"
    needs_sharp_render: bool = True
    samples_aperture: bool = False
    stage: str = "rasterise"

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """(H, W, 3) encoded: render the shot; differentiable."""
        return sharp.raster.color

    def cost(self, sharp: SharpView, shot: Shot, view: ScaledView) -> Tensor | None:
        """Return the model's own term of the loss for the image just rendered, or None."""
        return None


class Pinhole(ForwardModel):
    """No lens: the image is the sharp view."""


@dataclass(frozen=True, eq=False)
class BlurStart:
    """The state from which a learned blur starts.

    gaussians: the first ones. cameras: of the training views. extent: of the scene, scene units (`scene_extent`).
    generator: for all that the blur draws.
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
    def centre(self) -> Tensor:
        """(3,) the mean camera centre, scene units."""
        return beside(self.means, np.mean([camera.centre for camera in self.cameras], axis=0))


class LearnedBlur(ForwardModel):
    """Base of blur that is learned with the scene without a lens. Rendering the trained scene skips it.

    kernels: ops that it calls besides `rasterize`. begins: share of the training from which it replaces the sharp view.
    """

    stage = "blur"
    kernels: tuple[str, ...] = ()
    begins: float = 0.0
    _adam: NetworkAdam

    def models(self) -> Sequence[tuple[float, ForwardModel]]:
        """The forward models of the training, each with the share of it from which it is used; the first from 0."""
        return [(0.0, self)] if self.begins <= 0 else [(0.0, Pinhole()), (self.begins, self)]

    def gradient(self) -> Tensor | None:
        """All gradients of the last step in one row, for a check; None if there are none."""
        return self._adam.gradient()

    def step(self, view: int, progress: float, cooldown: float) -> None:
        """Learn from a step on view number `view` at `progress`, 0 to 1. cooldown: a factor on the rates."""
        self._adam.step(progress, cooldown)
