"""DoF-NeRF's concentrate-and-scatter (Wu et al., ACM MM 2022, section 3.2): a sharp patch of a photograph is rendered
with its depth, and each pixel's light is spread over its circle of confusion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.optics.defocus import defocus
from dofbench.training.common.lenses import LearnedLenses
from dofbench.training.fields.forward.lens_rays import circles
from dofbench.training.fields.forward.ray_model import Prediction, RayScene
from dofbench.training.fields.pixels import Pixels, TrainingPixels


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


class RenderedPatch:
    """A `RayModel` with a learned lens for every view. Light from beside a patch is missing at its border."""

    stage = "patch"
    kernels: tuple[str, ...] = ("adam", "scatter", "tone")

    def __init__(self, lenses: LearnedLenses, options: PatchOptions):
        self.lenses, self._options = lenses, options
        self._view: int | None = None

    def draw(self, photographs: TrainingPixels, count: int, progress: float) -> Pixels:
        """Pixels of all photographs at first, then a patch of one."""
        if progress < self._options.patch_from:
            return photographs.draw(count)
        return photographs.draw_patch(self._options.patch_side)

    def predict(self, scene: RayScene, pixels: Pixels, progress: float) -> Sequence[Prediction]:
        """The patch through the lens."""
        origins, directions = scene.cameras.rays(pixels.views, pixels.places)
        seen = scene.trace(origins, directions)
        self._view = None
        if progress < self._options.patch_from:
            return [Prediction(seen.color)]
        assert pixels.view is not None and pixels.width is not None  # as `draw` has them
        self._view = view = pixels.view
        slope, offset = circles(self.lenses, view, scene.cameras.widths[view])
        disparity = scene.disparity(origins, directions, seen)
        shape = len(pixels.views) // pixels.width, pixels.width
        radius = (slope * disparity + offset).view(shape)
        sharp = seen.color.view(*shape, 3).contiguous()
        return [Prediction(defocus(sharp, radius.contiguous(), self._options.blur).view(-1, 3))]

    def cost(self, progress: float) -> Tensor | None:
        """None."""
        return None

    def gradients(self) -> Mapping[str, Tensor | None]:
        """That of the last patch's lens."""
        return {"lens": None if self._view is None else self.lenses.gradient()}

    def step(self, progress: float) -> None:
        """A step on the lens of the last patch."""
        if self._view is not None:
            self.lenses.step(self._view, progress)
