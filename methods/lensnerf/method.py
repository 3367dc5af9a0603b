"""LensNeRF (Kim et al., WACV 2024): a thin lens for every view, sampled by rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.training.common.lenses import LearnedLenses
from dofbench.training.fields.lens_field import (
    LensFieldMethod,
    LensFieldOptions,
    LensRenderingOptions,
    SampledLensMethod,
    circles,
    disc_points,
)
from dofbench.training.fields.pixels import Pixels, TrainingPixels
from dofbench.training.fields.ray_model import Prediction, RayModel, RayTracer, mixed


@dataclass(frozen=True)
class LensRayOptions:
    """How a lens is sampled."""

    lens_points: int = 9
    """Rays from aperture samples that a pixel is mixed from. Unit: none. Source: LensNeRF, 3 x 3."""

    def __post_init__(self) -> None:
        if self.lens_points < 1:
            raise InputError("option lens_points", str(self.lens_points), "at least 1")


class LensRays(RayModel):
    """A pixel is the mean of rays from aperture samples, which meet in the plane of focus (Cook et al., 1984)."""

    stage = "lens rays"
    kernels = ("adam", "tone")

    def __init__(self, lenses: LearnedLenses, options: LensRayOptions, generator: torch.Generator):
        self.lenses, self._options, self._generator = lenses, options, generator
        self._view: int | None = None

    @property
    def rays_per_pixel(self) -> int:
        return self._options.lens_points

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Draw pixels of one view, since a step learns one lens."""
        return photographs.draw_view(count // self._options.lens_points)

    def predict(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        assert pixels.view is not None
        self._view = view = pixels.view
        count, device = self._options.lens_points, pixels.places.device
        points = disc_points(len(pixels.views), count, self._generator, device)
        focal = tracer.cameras.focal[view]
        slope, offset = circles(self.lenses, view, tracer.cameras.widths[view])
        # A point at disparity q, seen from s beside the lens's centre, moves by s (q - focus) against the pixel.
        shift, tilt = (points.view(-1, 2) * (value / focal) for value in (slope, offset))
        views, places = pixels.views.repeat_interleave(count), pixels.places.repeat_interleave(count, 0)
        seen = tracer.trace(*tracer.cameras.rays(views, places, shift, tilt))
        return [Prediction(mixed(seen.color.view(-1, count, 3), torch.full((1, count), 1 / count, device=device)))]

    def gradients(self) -> Mapping[str, Tensor | None]:
        return {"lens": self.lenses.gradient()}

    def step(self, progress: float) -> None:
        assert self._view is not None
        self.lenses.step(self._view, progress)


@dataclass(frozen=True)
class LensRayFieldOptions(LensFieldOptions):
    """Options of a field whose lenses are sampled."""

    lens_rays: LensRayOptions = LensRayOptions()
    rendering: LensRenderingOptions = LensRenderingOptions()


class LensNeRF(SampledLensMethod, LensFieldMethod):
    """A field with a learned lens per view; views are trained on, and rendered, through aperture samples."""

    OPTIONS = LensRayFieldOptions

    def lens_model(self, lenses: LearnedLenses, generator: torch.Generator) -> RayModel:
        assert isinstance(self._options, LensRayFieldOptions)
        return LensRays(lenses, self._options.lens_rays, generator)
