"""NeRFocus (Wang et al., 2022): trained as if all views were in focus, rendered through a lens."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import PhysicalLens
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.lens_field import LensRenderingOptions, SampledLensMethod


@dataclass(frozen=True)
class NeRFocusOptions(FieldOptions):
    """Options of a field, and of its rendering through a lens."""

    rendering: LensRenderingOptions = LensRenderingOptions()


class NeRFocus(SampledLensMethod):
    """A field that assumes all-in-focus inputs, rendered through aperture samples of any given lens."""

    OPTIONS = NeRFocusOptions

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        if lens is None:
            return super().render(camera, None)
        return self.render_defocused(self._trained(), camera, lens)
