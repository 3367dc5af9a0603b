"""A trained scene, rendered at any camera, through any lens and shape of the aperture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Method, Rendering
from dofbench.core.lens import ApertureShape, DisparityRange, Lens, PhysicalLens, in_scene_units
from dofbench.optics.defocus import defocus_numpy

_Render = Callable[[Camera, PhysicalLens | None], Rendering]  # as a method's `render`


class Renders(Protocol):
    """What renders: a method, or Gaussians alone."""

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """See `Method.render`."""


def _no_range() -> DisparityRange | None:
    return None


@dataclass(frozen=True, eq=False)
class Model:
    """A trained method that renders: `load_run(folder).model`.

    method: as trained. disparity_range: returns the range that a `Lens` refers to, None where none is known; called
    only for such a lens.
    """

    method: Method
    disparity_range: Callable[[], DisparityRange | None] = _no_range

    def __repr__(self) -> str:
        return f"Model({type(self.method).__name__})"

    def render(
        self, camera: Camera, lens: PhysicalLens | Lens | None = None, shape: ApertureShape = ApertureShape()
    ) -> Rendering:
        """Render at the camera, through the lens; None for all in focus.

        lens: a `Lens` in units of the dataset's disparity range, or a `PhysicalLens` in scene units of this camera.
        shape: of the aperture. Where it isn't a disc, and for a method without a lens, the all-in-focus rendering is
        blurred by its depth, in layers. Raises InputError for a `Lens` without a disparity range.
        """
        if isinstance(lens, Lens):
            lens = in_scene_units(lens, self.disparity_range(), camera.width)
        return renderer(self.method, shape)(camera, lens)


def renderer(method: Renders, shape: ApertureShape = ApertureShape()) -> _Render:
    """Render by the method's own lens, where it has one and the aperture is a disc; else blur its all-in-focus
    rendering by its depth, in layers."""
    blur = Blur(shape=shape, renderer="layered")

    def layered(camera: Camera, lens: PhysicalLens | None) -> Rendering:
        sharp = method.render(camera, None)
        if lens is None:
            return sharp
        return replace(sharp, image=defocus_numpy(sharp.image, sharp.depth, lens, blur)[0])

    def own(camera: Camera, lens: PhysicalLens | None) -> Rendering:
        try:
            return method.render(camera, lens)
        except ValueError:  # the method has no lens
            return layered(camera, lens)

    return own if shape.is_disc else layered
