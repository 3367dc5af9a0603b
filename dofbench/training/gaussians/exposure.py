"""Photographs and depth of trained Gaussians, at any camera and through any lens."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import PhysicalLens
from dofbench.runtime.raster import Geometry, Raster
from dofbench.training.gaussians.forward.forward_model import SharpView
from dofbench.training.gaussians.forward.forward_schedule import rendering_model
from dofbench.training.gaussians.forward.shot import Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise, rasterise_from_points


class StillRasteriser:
    """The `Rasteriser` for rendering: all spherical harmonics, no statistics, and an unrotated pattern of lens
    points."""

    def __init__(self, gaussians: Gaussians, appearance: AppearanceOptions):
        self.gaussians, self._appearance = gaussians, appearance

    def rasterise(self, camera: Camera, geometry: Geometry) -> Raster:
        """One sharp view."""
        return rasterise(self.gaussians, camera, self._appearance, geometry=geometry)

    def changed(self, camera: Camera, parameters: Mapping[str, Tensor]) -> Tensor:
        """(H, W, 3), a view with some parameters replaced."""
        return rasterise(self.gaussians, camera, self._appearance, geometry="none", changes=parameters).color

    def from_points(self, camera: Camera, points: np.ndarray, radius: Tensor, blur: Tensor) -> Tensor:
        """(P, H, W, 3) as seen from points of the lens."""
        return rasterise_from_points(self.gaussians, camera, self._appearance, points, radius, blur)

    def turn(self) -> float:
        """The rotation of the pattern of lens points: 0."""
        return 0.0


class Exposures:
    """Renders trained Gaussians through one lens after another.

    While the camera stays the same, as in a search for its lens, the sharp view is rasterised once and kept.
    """

    def __init__(self, gaussians: Gaussians, options: GaussianOptions):
        self._scene = StillRasteriser(gaussians, options.appearance)
        self._model = rendering_model(options.blur, options.scatter, options.samples)
        self._kept: tuple[Camera, SharpView] | None = None

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Image and depth. When `lens` is None, the image is all in focus and is always rasterised anew."""
        image, depth = self.image_and_depth(camera, lens)
        # A copy, since the sharp view is kept and the caller may write into the result.
        return Rendering(image=image.numpy(force=True), depth=depth.numpy(force=True).copy())

    @torch.no_grad()
    def image_and_depth(self, camera: Camera, lens: PhysicalLens | None) -> tuple[Tensor, Tensor]:
        """The same as tensors where the Gaussians lie: (H, W, 3), encoded, and (H, W), scene units."""
        if lens is None:
            raster = self._scene.rasterise(camera, "depth")
            assert raster.depth is not None
            return raster.color, raster.depth
        if self._kept is None or self._kept[0] is not camera:
            raster = self._scene.rasterise(camera, "depth")
            self._kept = camera, SharpView(lambda: raster)
        sharp = self._kept[1]
        assert sharp.raster.depth is not None
        return self._model.photograph(self._scene, sharp, Shot.through(lens, camera)), sharp.raster.depth


def render_view(
    gaussians: Gaussians, camera: Camera, options: GaussianOptions, *, lens: PhysicalLens | None
) -> Rendering:
    """Image and depth at any camera; all in focus when `lens` is None."""
    return Exposures(gaussians, options).render(camera, lens)
