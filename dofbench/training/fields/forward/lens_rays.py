"""A thin lens for every photograph, sampled by rays: a pixel is the mean of rays from points of the lens that meet in
the plane of focus (Cook et al., 1984; for fields LensNeRF and NeRFocus)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.core.lens import COC_FRACTION
from dofbench.training.common.lenses import LearnedLenses
from dofbench.training.fields.forward.mixed_rays import mixed
from dofbench.training.fields.forward.ray_model import Prediction, RayScene
from dofbench.training.fields.pixels import Pixels, TrainingPixels


@dataclass(frozen=True)
class LensRayOptions:
    """How a lens is sampled."""

    lens_points: int = 9
    """Rays from points of the lens that a pixel is mixed from. Unit: none. Source: LensNeRF, 3 x 3."""

    def __post_init__(self) -> None:
        if self.lens_points < 1:
            raise InputError("option lens_points", str(self.lens_points), "at least 1")


class LensRays:
    """A `RayModel` with a learned lens for every view."""

    stage = "lens rays"
    kernels: tuple[str, ...] = ("adam", "tone")

    def __init__(self, lenses: LearnedLenses, options: LensRayOptions, generator: torch.Generator):
        self.lenses, self._options, self._generator = lenses, options, generator
        self._view: int | None = None

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of one photograph, since a step learns one lens; fewer by the number of rays that each is mixed
        from."""
        return photographs.draw_view(count // self._options.lens_points)

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The mean light of the rays from points of the lens."""
        assert pixels.view is not None  # as `draw` has it
        self._view = view = pixels.view
        count, device = self._options.lens_points, pixels.places.device
        points = disc_points(len(pixels.views), count, self._generator, device)
        focal = scene.cameras.focal[view]
        slope, offset = circles(self.lenses, view, scene.cameras.widths[view])
        # A point at disparity q, seen from beside the lens's centre by s, moves by s (q - focus) against the pixel.
        shift, tilt = (points.view(-1, 2) * (value / focal) for value in (slope, offset))
        seen = scene.trace(
            *scene.cameras.rays(
                pixels.views.repeat_interleave(count), pixels.places.repeat_interleave(count, 0), shift, tilt
            )
        )
        return [Prediction(mixed(seen.color.view(-1, count, 3), torch.full((1, count), 1 / count, device=device)))]

    def cost(self, progress: float) -> Tensor | None:
        """None."""
        return None

    def gradients(self) -> Mapping[str, Tensor | None]:
        """That of the last photograph's lens."""
        return {"lens": self.lenses.gradient()}

    def step(self, progress: float) -> None:
        """A step on the lens of the last photograph."""
        assert self._view is not None
        self.lenses.step(self._view, progress)


def circles(lenses: LearnedLenses, view: int, width: float) -> tuple[Tensor, Tensor]:
    """(slope, offset): the signed circle of confusion of disparity q, 1 / scene unit, is slope q + offset, pixels of an
    image `width` wide; differentiable by the lens's parameters."""
    slope, offset = lenses.forward(view)
    bounds = lenses.ranges[view]
    scaled = COC_FRACTION * width * slope / bounds.extent
    return scaled, COC_FRACTION * width * offset - scaled * bounds.q_min


def disc_points(pixels: int, count: int, generator: torch.Generator, device: torch.device | str = "cpu") -> Tensor:
    """(P, N, 2) points of the unit disc, for each pixel one in each of N parts of equal area (sectors of the disc's
    polar coordinates, turned at random). generator: the host's, whichever device the points are for."""
    within, turn = (
        torch.rand(pixels, columns, generator=generator).to(device, non_blocking=True) for columns in (count, 1)
    )
    part = torch.arange(count, device=device)
    radius = (part + within).div(count).sqrt()
    golden = math.pi * (3 - math.sqrt(5))
    angle = golden * part + 2 * math.pi * turn
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], -1)
