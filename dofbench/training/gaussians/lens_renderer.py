"""Rendering trained Gaussians at any camera through any lens, and the size of learned lenses' CoCs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.runtime.raster import Geometry, Raster
from dofbench.training.common.depth import surface_disparity
from dofbench.training.gaussians.forward_model import SharpView, Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_models import rendering_model
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import AppearanceOptions, rasterise, rasterise_from_points

_WIDE_PIXELS, _WIDE_VIEWS = 0.95, 0.9  # quantiles
_MIDDLE = 0.25, 0.75  # quantiles of the lenses; lenses outside them may be badly learned


class StillRasteriser:
    """The `Rasteriser` of rendering: all spherical harmonics, no statistics, aperture samples not rotated."""

    def __init__(self, gaussians: Gaussians, appearance: AppearanceOptions):
        self.gaussians, self._appearance = gaussians, appearance

    def rasterise(self, camera: Camera, geometry: Geometry) -> Raster:
        return rasterise(self.gaussians, camera, self._appearance, geometry=geometry)

    def rasterise_with(self, camera: Camera, parameters: Mapping[str, Tensor]) -> Tensor:
        return rasterise(self.gaussians, camera, self._appearance, geometry="none", changes=parameters).color

    def rasterise_from_points(self, camera: Camera, points: np.ndarray, radius: Tensor, blur: Tensor) -> Tensor:
        return rasterise_from_points(self.gaussians, camera, self._appearance, points, radius, blur)

    def turn(self) -> float:
        return 0.0


class LensRenderer:
    """Renders trained Gaussians through one lens after another.

    While the camera object stays the same, as in a search for its lens, the sharp view is rasterised once and kept.
    """

    def __init__(self, gaussians: Gaussians, options: GaussianOptions):
        self._scene = StillRasteriser(gaussians, options.appearance)
        self._model = rendering_model(options.blur, options.scatter, options.samples)
        self._kept: tuple[Camera, SharpView] | None = None

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render image and depth. Without a lens the image is all in focus, and is always rasterised anew."""
        image, depth = self.image_and_depth(camera, lens)
        # A copy, since the sharp view is kept and the caller may write into the result.
        return Rendering(image=image.numpy(force=True), depth=depth.numpy(force=True).copy())

    @torch.no_grad()
    def image_and_depth(self, camera: Camera, lens: PhysicalLens | None) -> tuple[Tensor, Tensor]:
        """As `render`, as tensors on the Gaussians' device: (H, W, 3), encoded, and (H, W), scene units."""
        if lens is None:
            raster = self._scene.rasterise(camera, "depth")
            assert raster.depth is not None
            return raster.color, raster.depth
        if self._kept is None or self._kept[0] is not camera:
            raster = self._scene.rasterise(camera, "depth")
            self._kept = camera, SharpView(lambda: raster)
        sharp = self._kept[1]
        assert sharp.raster.depth is not None
        return self._model.render(self._scene, sharp, Shot.through(lens, camera)), sharp.raster.depth


@torch.no_grad()
def widest_circle(gaussians: Gaussians, shots: Sequence[Shot], appearance: AppearanceOptions) -> float:
    """Radius of the widest CoCs, px: the 0.95 quantile over a view's pixels, then the 0.9 quantile over the views, of
    which some may be in focus everywhere."""
    widest = []
    for shot in shots:
        raster = rasterise(gaussians, shot.camera, appearance, sh_degree=0)
        assert raster.depth is not None
        radii = shot.circles(surface_disparity(raster.depth, raster.alpha))
        widest.append(np.quantile(radii.numpy(force=True), _WIDE_PIXELS))
    return float(np.quantile(widest, _WIDE_VIEWS))


@torch.no_grad()
def foci_apart(shots: Sequence[Shot], bounds: DisparityRange) -> float:
    """Difference of one point's CoC radii between lenses, px of a camera of the median focal length.

    It is the spread over the middle half of the lenses, at that end of the disparity range where it is larger.
    """
    focal = np.array([shot.camera.fx for shot in shots])
    ends = np.array(
        [[float(shot.radius(torch.tensor(disparity))) for shot in shots] for disparity in (bounds.q_min, bounds.q_max)]
    )
    low, high = np.quantile(ends * (np.median(focal) / focal), _MIDDLE, axis=1)
    return float((high - low).max())
