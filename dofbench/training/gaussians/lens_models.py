"""Forward models of a lens (scatter renderer, aperture samples, each Gaussian's own blur) and their schedule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.lens import ALPHA, ApertureShape, Energy
from dofbench.optics.defocus import scatter_defocus
from dofbench.optics.tone import fast_decode, fast_encode
from dofbench.runtime.device_numbers import beside
from dofbench.training.gaussians.forward_model import BlurOptions, ForwardModel, Pinhole, Rasteriser, SharpView, Shot
from dofbench.training.gaussians.lens_pattern import MOST_RINGS, cell_variance, lens_points, rings_for
from dofbench.training.gaussians.model import Gaussians


@dataclass(frozen=True)
class ScatterOptions:
    """The shape and weight of the circle over which a pixel is spread."""

    lens_alpha: float = ALPHA
    """Steepness of the circle's rim, 1/2 + 1/2 tanh(alpha (R - l)). Unit: 1 / px. Source: Algorithm 1."""
    lens_energy: Energy = "area"
    """How a spread pixel is weighted: area, divided by its circle's area; algorithm1, not divided. Unit: none. Source:
    area: released code; algorithm1: Algorithm 1."""
    lens_blades: int = 0
    """Number of sides of a polygonal aperture; 0 for a disc. Unit: none. Source: own."""
    lens_rotation: float = 0.0
    """Rotation of the polygon. Unit: rad. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_blades < 0 or self.lens_blades in (1, 2):
            raise InputError("option lens_blades", str(self.lens_blades), "0, a disc, or at least 3")


class ScatterBlur(ForwardModel):
    """The scatter renderer (DoF-Gaussian, Algorithm 1): each pixel of the sharp view is spread over its CoC."""

    reads = "depth"
    stage = "lens"

    def __init__(self, blur: BlurOptions, options: ScatterOptions):
        shape = ApertureShape(options.lens_blades, options.lens_rotation)
        self._to_depth = blur.blur_to_depth
        self._spread = Blur(blur.lens_gamma, options.lens_alpha, shape, options.lens_energy)

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Scatter the sharp view by its disparity."""
        disparity = sharp.disparity if self._to_depth else sharp.disparity.detach()
        return self.spread(sharp.raster.color, disparity, shot)

    def spread(self, colour: Tensor, disparity: Tensor, shot: Shot) -> Tensor:
        """Scatter an encoded sharp image (H, W, 3) by its disparity (H, W), 1 / scene unit."""
        return scatter_defocus(colour, shot.radius(disparity), self._spread)


@dataclass(frozen=True)
class SamplesOptions:
    """How many lens points are used, and from when on."""

    lens_rings: int = 1
    """Number k of rings of points on the lens: 1 has five points, k > 1 has 1 + 3 k (k + 1) in all; fewer rings are
    used for a photograph with small circles of confusion; 0 blurs each Gaussian by its own circle of confusion. Unit:
    none. Source: own; 0: DOF-GS, CoCoGaussian."""
    lens_samples_from: float = 0.5
    """With lens_model=samples, when the lens points replace the scatter. Unit: share of the training. Source: own."""
    lens_rings_from: float = 0.0
    """With lens_model=samples, when the rings begin; before that the lens's centre is the only point. Unit: share of
    the training. Source: own."""

    def __post_init__(self) -> None:
        if self.lens_rings < 0:
            raise InputError("option lens_rings", str(self.lens_rings), "at least 0")


class LensSamples(ForwardModel):
    """The mean of views from aperture samples, with physically correct occlusion; as many as an image's CoCs need.

    Moving a Gaussian across the image by (signed CoC radius) x (point of the unit lens) is the sheared camera of a thin
    lens focused on its plane (Potmesil and Chakravarty, 1982; Kolb et al., 1995). Each point stands for a cell of the
    lens, all of equal area. The blur within a cell is a variance added to each Gaussian's footprint, so that few points
    show no ghost images (`lens_pattern.py`). most: largest number of rings of points.
    """

    needs_sharp_render = False
    samples_aperture = True
    stage = "lens"

    def __init__(self, blur: BlurOptions, most: int):
        self._blur, self._most = blur, most

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Average the views from the aperture samples in linear light."""
        rings = rings_for(circles_in_view(scene.gaussians, shot), self._most)
        return mean_light(views_from_lens(scene, shot, rings, self._blur.blur_to_depth), self._blur.lens_gamma)


class OwnBlur(LensSamples):
    """One aperture sample, the centre, whose cell is the whole lens: each Gaussian is enlarged by its own CoC (DOF-GS,
    CoCoGaussian).

    As fast as the scatter renderer, but a blurred foreground shows what lies behind it.
    """

    def __init__(self, blur: BlurOptions):
        super().__init__(blur, 0)

    def render(self, scene: Rasteriser, sharp: SharpView, shot: Shot) -> Tensor:
        """Rasterise the blurred Gaussians."""
        return views_from_lens(scene, shot, 0, self._blur.blur_to_depth)[0]


def views_from_lens(scene: Rasteriser, shot: Shot, rings: int, to_depth: bool) -> Tensor:
    """(P, H, W, 3): the scene from each point of the lens. to_depth: whether gradients reach the depth by which
    Gaussians are moved and blurred."""
    depth = depth_of(scene.gaussians, shot.camera)
    if not to_depth:
        depth = depth.detach()
    radius = shot.radius(1 / depth)
    # An angle is drawn for the centre alone too: the order of views uses the same random numbers, and must not depend
    # on the number of aperture samples.
    points = lens_points(rings, scene.turn())
    return scene.rasterise_from_points(shot.camera, points, radius, cell_variance(radius, rings))


@torch.no_grad()
def circles_in_view(gaussians: Gaussians, shot: Shot) -> Tensor:
    """(N,) CoC radii of the Gaussians, px; NaN where the mean isn't in the image."""
    means, camera = gaussians.parameters["means"], shot.camera
    pose = beside(means, camera.world_to_camera)
    x, y, z = (means @ pose[:3, :3].T + pose[:3, 3]).unbind(1)
    u, v = camera.pixels(x, y, z)
    seen = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return torch.where(seen, shot.circles(1 / z), math.nan)


def depth_of(gaussians: Gaussians, camera: Camera) -> Tensor:
    """(N,) z of the means in the camera's frame, scene units; differentiable. Raised to the near plane, so that the
    blur of what isn't drawn is finite too."""
    means = gaussians.parameters["means"]
    pose = beside(means, camera.world_to_camera)
    return (means @ pose[2, :3] + pose[2, 3]).clamp_min(gaussians.near)


def mean_light(images: Tensor, gamma: float) -> Tensor:
    """(H, W, 3), encoded: average P encoded images (P, H, W, 3) in linear light."""
    return images[0] if len(images) == 1 else fast_encode(fast_decode(images, gamma).mean(0), gamma)


class ForwardSchedule:
    """Forward models, each with the share of the training from which it is used; the first starts at 0."""

    def __init__(self, models: Sequence[tuple[float, ForwardModel]]):
        self._models = tuple(models)

    def at(self, progress: float) -> ForwardModel:
        """The model at `progress`, 0 to 1: the last one whose start has been reached."""
        return [model for start, model in self._models if start <= progress][-1]

    def after(self, first: ForwardModel, until: float) -> ForwardSchedule:
        """This schedule, with another model before `until`, a share of the training."""
        later = [(max(start, until), model) for start, model in self._models]
        return ForwardSchedule([(0.0, first), *later]) if until > 0 else self

    @property
    def models(self) -> tuple[ForwardModel, ...]:
        """All models of the schedule, in order."""
        return tuple(model for _, model in self._models)


def training_models(lens: bool, blur: BlurOptions, scatter: ScatterOptions, samples: SamplesOptions) -> ForwardSchedule:
    """The forward models of a training.

    With lens_model=samples the scatter renderer comes first, to find roughly where the lens is focused, then the lens's
    centre alone, and rings of points last, since every point costs a rasterisation.
    """
    if not lens:
        return ForwardSchedule([(0.0, Pinhole())])
    models: list[tuple[float, ForwardModel]] = [(0.0, ScatterBlur(blur, scatter))]
    if blur.lens_model == "samples":
        models.append((samples.lens_samples_from, OwnBlur(blur)))
        if samples.lens_rings > 0:
            start = max(samples.lens_samples_from, samples.lens_rings_from)
            models.append((start, LensSamples(blur, samples.lens_rings)))
    return ForwardSchedule(models)


def rendering_model(blur: BlurOptions, scatter: ScatterOptions, samples: SamplesOptions) -> ForwardModel:
    """The forward model that renders a trained scene, with up to `MOST_RINGS` rings where CoCs are wide."""
    if blur.lens_model == "scatter":
        return ScatterBlur(blur, scatter)
    return LensSamples(blur, max(samples.lens_rings, MOST_RINGS)) if samples.lens_rings > 0 else OwnBlur(blur)
