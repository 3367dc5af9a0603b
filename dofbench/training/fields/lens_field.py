"""Radiance fields with a lens: learned for every view, sampled by rays or scattered by depth when rendering."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering, TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.lens import COC_FRACTION, DisparityRange, PhysicalLens
from dofbench.optics.defocus import defocus_numpy
from dofbench.training.common.depth import all_disparities
from dofbench.training.common.lens_file import read_lenses, write_lenses
from dofbench.training.common.lenses import LearnedLenses, LensOptions, first_lenses
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.field_scene import FieldScene
from dofbench.training.fields.field_trainer import FieldTrainer
from dofbench.training.fields.pixels import CameraTable, whole_image
from dofbench.training.fields.ray_model import RayModel, mixed

_LENSES = "lenses.json"
_RAYS = 8192  # rendered at once


@dataclass(frozen=True)
class LensFieldOptions(FieldOptions):
    """Options of a radiance field, and of its lenses."""

    lens: LensOptions = LensOptions()

    def __post_init__(self) -> None:
        if not self.lens.lens:
            raise InputError("option lens", "false", "true: this method has a lens")
        if self.lens.lens_range != "points" or self.lens.lens_clip:
            raise InputError("option lens_range", "render, or lens_clip", "points without lens_clip, for a field")


@dataclass(frozen=True)
class LensRenderingOptions:
    """How finely a lens is sampled in a photograph that is rendered."""

    render_points: int = 16
    """Rays from aperture samples that a pixel of a rendered photograph is mixed from. Unit: none. Source: own."""

    def __post_init__(self) -> None:
        if self.render_points < 1:
            raise InputError("option render_points", str(self.render_points), "at least 1")


class LensFieldMethod(FieldMethod, ABC):
    """Base of the fields that learn a lens for every view."""

    OPTIONS: ClassVar[type[FieldOptions]] = LensFieldOptions

    def __init__(self, options: Mapping[str, Any], seed: int, device: str):
        super().__init__(options, seed, device)
        self._learned: tuple[LearnedLenses, list[tuple[str, int]]] | None = None
        self._lenses: dict[str, PhysicalLens] | None = None

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        assert training_set.points is not None and isinstance(self._options, LensFieldOptions)
        options, views = self._options.lens, training_set.views
        cameras = [view.camera for view in views]
        bounds = DisparityRange.of_disparity(all_disparities(training_set.points, cameras))
        lenses = first_lenses(views, bounds, options, self._device)
        self._learned = lenses, [(view.name, view.camera.width) for view in views]
        return self.lens_model(lenses, generator)

    def training_state(self) -> dict[str, Any]:
        """See `dofbench.core.contracts.Resumes`."""
        return {**super().training_state(), "learned": self._learned}

    def _take_over(self, kept: dict[str, Any], trainer: FieldTrainer) -> None:
        super()._take_over(kept, trainer)
        self._learned = kept["learned"]

    @abstractmethod
    def lens_model(self, lenses: LearnedLenses, generator: torch.Generator) -> RayModel:
        """Make the forward model of these lenses."""

    @abstractmethod
    def render_defocused(self, scene: FieldScene, camera: Camera, lens: PhysicalLens) -> Rendering:
        """Render through a given lens."""

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render all in focus, or through a lens."""
        scene = self._trained()
        return scene.render(camera) if lens is None else self.render_defocused(scene, camera, lens)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The learned lens of every training view."""
        if self._learned is None:
            return self._lenses
        lenses, views = self._learned
        return {name: lenses.estimate(number, width) for number, (name, width) in enumerate(views)}

    def save(self, folder: Path) -> None:
        """Write the field and the lenses."""
        super().save(folder)
        write_lenses(folder / _LENSES, self.lens_estimates(), {}, {})

    def load(self, folder: Path) -> None:
        super().load(folder)
        self._lenses, _ = read_lenses(folder / _LENSES, ())
        self._learned = None


class SampledLensMethod(FieldMethod):
    """Part of a method that renders through a lens by aperture samples. Its options have `rendering`."""

    def render_defocused(self, scene: FieldScene, camera: Camera, lens: PhysicalLens) -> Rendering:
        """Render by `render_points` aperture samples a pixel."""
        return through_points(scene, camera, lens, int(self.options.flat()["render_points"]))

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        """Scatter the sharp view, which is much faster."""
        return scattered(sharp, lens)


@torch.no_grad()
def through_points(scene: FieldScene, camera: Camera, lens: PhysicalLens, count: int) -> Rendering:
    """Render through a lens by `count` aperture samples a pixel, the same in every call; depth is of the sharp view."""
    device = scene.device
    table, places = CameraTable([camera], device), whole_image(camera, device)
    generator = torch.Generator().manual_seed(0)
    aperture = lens.aperture_at(camera.width)
    parts = []
    for part in places.split(max(1, _RAYS // count)):
        points = disc_points(len(part), count, generator, device).view(-1, 2)
        shift = points * (aperture / table.focal[0])
        views = torch.zeros(len(part) * count, dtype=torch.int64, device=device)
        rays = table.rays(views, part.repeat_interleave(count, 0), shift, -lens.focus_disparity * shift)
        seen = scene.see(*rays, torch.full((len(views),), 0.5, device=device))
        parts.append(mixed(seen.color.view(-1, count, 3), torch.full((1, count), 1 / count, device=device)))
    image = torch.cat(parts).view(camera.height, camera.width, 3).clamp(0, 1).numpy(force=True)
    return Rendering(image, scene.render(camera).depth)


def scattered(sharp: Rendering, lens: PhysicalLens, blur: Blur = Blur()) -> Rendering:
    """Spread the pixels of a sharp view over their CoCs."""
    image, _ = defocus_numpy(sharp.image, sharp.depth, lens, blur)
    return Rendering(image.clip(0, 1), sharp.depth)


def circles(lenses: LearnedLenses, view: int, width: float) -> tuple[Tensor, Tensor]:
    """(slope, offset): the signed CoC radius at disparity q, 1 / scene unit, is slope q + offset, px of an image
    `width` wide; differentiable with respect to the lens."""
    slope, offset = lenses.forward(view)
    bounds = lenses.ranges[view]
    scaled = COC_FRACTION * width * slope / bounds.extent
    return scaled, COC_FRACTION * width * offset - scaled * bounds.q_min


def disc_points(pixels: int, count: int, generator: torch.Generator, device: torch.device | str = "cpu") -> Tensor:
    """(P, N, 2) points of the unit disc: for each pixel one in each of N parts of equal area, sectors in the disc's
    polar coordinates, turned at random. generator: the host's, whatever the device."""
    within, turn = (
        torch.rand(pixels, columns, generator=generator).to(device, non_blocking=True) for columns in (count, 1)
    )
    part = torch.arange(count, device=device)
    radius = (part + within).div(count).sqrt()
    golden = math.pi * (3 - math.sqrt(5))
    angle = golden * part + 2 * math.pi * turn
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], -1)
