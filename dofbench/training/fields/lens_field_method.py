"""Radiance fields with a learned lens for every view."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering, TrainingSet
from dofbench.core.errors import InputError
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.training.common.first_lenses import first_lenses
from dofbench.training.common.lens_file import read_lenses, write_lenses
from dofbench.training.common.lenses import LearnedLenses, LensOptions
from dofbench.training.common.supervision import all_disparities
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.field_scene import FieldScene
from dofbench.training.fields.forward.lens_rays import LensRayOptions, LensRays
from dofbench.training.fields.forward.ray_model import RayModel
from dofbench.training.fields.forward.rendered_patch import PatchOptions, RenderedPatch
from dofbench.training.fields.lens_rendering import LensRenderingOptions, scattered, through_points

_LENSES = "lenses.json"


@dataclass(frozen=True)
class LensFieldOptions(FieldOptions):
    """Those of a radiance field, and of its lenses."""

    lens: LensOptions = LensOptions()

    def __post_init__(self) -> None:
        if not self.lens.lens:
            raise InputError("option lens", "false", "true: this method has a lens")
        if self.lens.lens_range != "points" or self.lens.lens_clip:
            raise InputError("option lens_range", "render, or lens_clip", "points without lens_clip, for a field")


@dataclass(frozen=True)
class LensRayFieldOptions(LensFieldOptions):
    """Those of a field whose lenses are sampled."""

    lens_rays: LensRayOptions = LensRayOptions()
    rendering: LensRenderingOptions = LensRenderingOptions()


@dataclass(frozen=True)
class PatchFieldOptions(LensFieldOptions):
    """Those of a field whose sharp patches are scattered."""

    patches: PatchOptions = PatchOptions()


@dataclass(frozen=True)
class RefocusedFieldOptions(FieldOptions):
    """Those of a field that is rendered through a lens, but was trained without one."""

    rendering: LensRenderingOptions = LensRenderingOptions()


class RefocusedField(FieldMethod):
    """A field that takes every photograph for sharp, and is rendered through any lens that is given."""

    OPTIONS = RefocusedFieldOptions

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render all in focus, or through a lens; see `through_points`."""
        if lens is None:
            return super().render(camera, None)
        assert isinstance(self._options, RefocusedFieldOptions)
        return through_points(self._trained(), camera, lens, self._options.rendering.render_points)

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        """See `scattered`."""
        return scattered(sharp, lens)


class LensFieldMethod(FieldMethod, ABC):
    """Base of the fields with lenses: what they share whichever way a lens blurs."""

    OPTIONS: ClassVar[type[FieldOptions]] = LensFieldOptions

    def __init__(self, options: Mapping[str, Any], seed: int, device: str):
        super().__init__(options, seed, device)
        self._learned: tuple[LearnedLenses, list[tuple[str, int]]] | None = None
        self._lenses: dict[str, PhysicalLens] | None = None

    def model(self, training_set: TrainingSet, generator: torch.Generator) -> RayModel:
        """The forward model, with a lens for every view."""
        assert training_set.points is not None and isinstance(self._options, LensFieldOptions)
        options, views = self._options.lens, training_set.views
        cameras = [view.camera for view in views]
        bounds = DisparityRange.of_disparity(all_disparities(training_set.points, cameras))
        lenses = first_lenses(views, bounds, options, self._device)
        self._learned = lenses, [(view.name, view.camera.width) for view in views]
        return self.lens_model(lenses, generator)

    @abstractmethod
    def lens_model(self, lenses: LearnedLenses, generator: torch.Generator) -> RayModel:
        """The forward model that these lenses blur in."""

    @abstractmethod
    def photograph(self, scene: FieldScene, camera: Camera, lens: PhysicalLens) -> Rendering:
        """A photograph through a lens that is given."""

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render all in focus, or through a lens."""
        scene = self._trained()
        return scene.render(camera) if lens is None else self.photograph(scene, camera, lens)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The learned lens of every training view."""
        if self._learned is None:
            return self._lenses
        lenses, views = self._learned
        return {name: lenses.estimate(number, width) for number, (name, width) in enumerate(views)}

    def save(self, folder: Path) -> None:
        """Write the field, and the lenses beside it."""
        super().save(folder)
        write_lenses(folder / _LENSES, self.lens_estimates(), {}, {})

    def load(self, folder: Path) -> None:
        """Read a model that `save` wrote; raises InputError when a file is missing or damaged."""
        super().load(folder)
        self._lenses, _ = read_lenses(folder / _LENSES, ())
        self._learned = None


class LensRayField(LensFieldMethod):
    """Photographs through a lens that is sampled by rays."""

    OPTIONS = LensRayFieldOptions

    def lens_model(self, lenses: LearnedLenses, generator: torch.Generator) -> RayModel:
        """See `LensRays`."""
        return LensRays(lenses, self._own.lens_rays, generator)

    def photograph(self, scene: FieldScene, camera: Camera, lens: PhysicalLens) -> Rendering:
        """See `through_points`."""
        return through_points(scene, camera, lens, self._own.rendering.render_points)

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        """See `scattered`."""
        return scattered(sharp, lens)

    @property
    def _own(self) -> LensRayFieldOptions:
        assert isinstance(self._options, LensRayFieldOptions)
        return self._options


class PatchField(LensFieldMethod):
    """Photographs as scattered sharp views."""

    OPTIONS = PatchFieldOptions

    def lens_model(self, lenses: LearnedLenses, generator: torch.Generator) -> RayModel:
        """See `RenderedPatch`."""
        return RenderedPatch(lenses, self._patches)

    def photograph(self, scene: FieldScene, camera: Camera, lens: PhysicalLens) -> Rendering:
        """See `scattered`."""
        return self.sketch(scene.render(camera), lens)

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        """The photograph itself: its sharp view is what takes long."""
        return scattered(sharp, lens, self._patches.blur)

    @property
    def _patches(self) -> PatchOptions:
        assert isinstance(self._options, PatchFieldOptions)
        return self._options.patches
