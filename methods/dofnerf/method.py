"""DoF-NeRF (Wu et al., ACM MM 2022): a learned lens for every view, by concentrate-and-scatter (section 3.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens
from dofbench.optics.defocus import scatter_defocus
from dofbench.training.common.lenses import LearnedLenses
from dofbench.training.fields.field_scene import FieldScene
from dofbench.training.fields.lens_field import LensFieldMethod, LensFieldOptions, circles, scattered
from dofbench.training.fields.pixels import Pixels, TrainingPixels
from dofbench.training.fields.ray_model import RAYS_AT_ONCE, Prediction, RayModel, RayTracer


@dataclass(frozen=True)
class PatchOptions:
    """Size of the patches, and when they begin."""

    patch_side: int = 48
    """Height and width of a patch. Unit: px. Source: DoF-NeRF."""
    patch_from: float = 0.3
    """When patches through the lens replace single sharp pixels. Unit: share of the training. Source: own; the length
    of DoF-NeRF's second stage isn't published."""
    patch_gamma: float = 2.0
    """Gamma of the light that is spread. Unit: none. Source: DoF-NeRF's code."""

    def __post_init__(self) -> None:
        if self.patch_side < 2:
            raise InputError("option patch_side", str(self.patch_side), "at least 2")

    @property
    def blur(self) -> Blur:
        """How light is spread."""
        return Blur(self.patch_gamma)


class RenderedPatch(RayModel):
    """Renders a sharp patch of a view with its depth, and spreads each pixel's light over its CoC.

    Light from outside the patch is missing at its border.
    """

    stage = "patch"
    kernels = ("adam", "scatter", "tone")

    def __init__(self, lenses: LearnedLenses, options: PatchOptions):
        self.lenses, self._options = lenses, options
        self._view: int | None = None

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Draw pixels of all views at first, then a patch of one."""
        if progress < self._options.patch_from:
            return photographs.draw(count)
        return photographs.draw_patch(self._options.patch_side)

    def predict(self, tracer: RayTracer, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        self._view = None
        if progress < self._options.patch_from:
            return super().predict(tracer, pixels, progress)
        sharp, disparity = _seen(tracer, pixels)
        self._view = pixels.view
        return [Prediction(self._scattered(tracer, pixels, sharp, disparity))]

    @torch.no_grad()
    def predict_view(self, tracer: RayTracer, pixels: Pixels, asked: Tensor) -> Tensor:
        """(P, 3): scatter the whole view, all of which may show at a pixel; every pixel is predicted."""
        if self._options.patch_from > 1:
            return super().predict_view(tracer, pixels, asked)
        numbers = torch.arange(len(pixels.views), device=pixels.views.device)
        parts = [_seen(tracer, pixels.at(part)) for part in numbers.split(RAYS_AT_ONCE)]
        sharp, disparity = (torch.cat(values) for values in zip(*parts, strict=True))
        return self._scattered(tracer, pixels, sharp, disparity)

    def _scattered(self, tracer: RayTracer, pixels: Pixels, sharp: Tensor, disparity: Tensor) -> Tensor:
        """(P, 3): spread the light of a patch of sharp colours (P, 3) at disparities (P,), 1 / scene unit."""
        assert pixels.view is not None and pixels.width is not None
        slope, offset = circles(self.lenses, pixels.view, tracer.cameras.widths[pixels.view])
        shape = len(pixels.views) // pixels.width, pixels.width
        radius = (slope * disparity + offset).view(shape)
        image = sharp.view(*shape, 3).contiguous()
        return scatter_defocus(image, radius.contiguous(), self._options.blur).view(-1, 3)

    def gradients(self) -> Mapping[str, Tensor | None]:
        return {"lens": None if self._view is None else self.lenses.gradient()}

    def step(self, progress: float) -> None:
        if self._view is not None:
            self.lenses.step(self._view, progress)


def _seen(tracer: RayTracer, pixels: Pixels) -> tuple[Tensor, Tensor]:
    """Sharp colours (P, 3) and disparities (P,), 1 / scene unit, of pixels."""
    origins, directions = tracer.cameras.rays(pixels.views, pixels.places)
    seen = tracer.trace(origins, directions)
    return seen.color, tracer.scene.disparity(origins, directions, seen)


@dataclass(frozen=True)
class PatchFieldOptions(LensFieldOptions):
    """Options of a field whose sharp patches are scattered."""

    patches: PatchOptions = PatchOptions()


class DoFNeRF(LensFieldMethod):
    """A field with a learned lens per view; sharp patches in training, and sharp views in rendering, are scattered."""

    OPTIONS = PatchFieldOptions

    def lens_model(self, lenses: LearnedLenses, generator: torch.Generator) -> RayModel:
        return RenderedPatch(lenses, self._patches)

    def render_defocused(self, scene: FieldScene, camera: Camera, lens: PhysicalLens) -> Rendering:
        return self.sketch(scene.render(camera), lens)

    def sketch(self, sharp: Rendering, lens: PhysicalLens) -> Rendering:
        """Scatter the sharp view; this is the rendering itself."""
        return scattered(sharp, lens, self._patches.blur)

    @property
    def _patches(self) -> PatchOptions:
        assert isinstance(self._options, PatchFieldOptions)
        return self._options.patches
