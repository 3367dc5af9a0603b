"""From Gaussians to sharp images and depth, in training and rendering."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import load
from dofbench.runtime.raster import Geometry, Raster, ViewStatistics
from dofbench.training.gaussians.model import Gaussians


@dataclass(frozen=True)
class AppearanceOptions:
    """How Gaussians are drawn: spherical harmonics, the filters against aliasing, the background."""

    sh_degree: int = 3
    """Highest degree of the spherical harmonics. Unit: none. Source: 3DGS."""
    sh_every: float = 1 / 30
    """Interval at which one more degree of the spherical harmonics is learned; 0 for all degrees from the start. Unit:
    share of the training. Source: 3DGS, 1000 of 30 000 steps."""
    background: float = 0.0
    """Colour behind the scene, encoded, 0 for black. Unit: grey level. Source: 3DGS."""
    filter_2d: float = 0.1
    """Mip-Splatting's 2D filter, added to every footprint's variance; 0 switches it off. Unit: px^2.
    Source: Mip-Splatting; 0 in the released code."""
    filter_3d: bool = True
    """Whether Gaussians are at least as large as their finest sampling. Unit: none. Source: Mip-Splatting."""

    near_share: float = 0.0
    """Near plane of the scene: what is nearer to a camera isn't drawn. 0 for 3DGS's 0.2 scene units, or nearer if the
    sparse points reach so near. Unit: distance of the nearest sparse points. Source: own."""

    @property
    def filter_2d_fades(self) -> bool:
        """Whether the 2D filter lowers opacities."""
        return True

    def degree(self, progress: float) -> int:
        """The degree of the spherical harmonics at `progress` of the training, 0 to 1."""
        return min(self.sh_degree, int(progress / self.sh_every)) if self.sh_every > 0 else self.sh_degree


def rasterise(
    gaussians: Gaussians,
    camera: Camera,
    appearance: AppearanceOptions,
    *,
    sh_degree: int | None = None,
    geometry: Geometry = "depth",
    statistics: ViewStatistics | None = None,
    changes: Mapping[str, Tensor] | None = None,
) -> Raster:
    """Rasterise with the method's filters and background. sh_degree: None for all; those that training hasn't reached
    are zero. changes: parameters that replace the Gaussians' own."""
    drawn = {**_drawn(gaussians, camera, appearance, sh_degree), **(changes or {})}
    raster: Raster = load("rasterize")(**drawn, geometry=geometry, statistics=statistics)
    return raster


def rasterise_from_points(
    gaussians: Gaussians,
    camera: Camera,
    appearance: AppearanceOptions,
    points: np.ndarray,
    radius: Tensor,
    blur: Tensor,
    *,
    sh_degree: int | None = None,
    statistics: ViewStatistics | None = None,
) -> Tensor:
    """(P, H, W, 3): rasterise from points (P, 2) of the unit lens.

    radius: (N,) signed CoC radii, px. blur: (N,) px^2, the variance of the blur of a point's cell. Gradients reach
    both. The other arguments are those of `rasterise`.
    """
    images: Tensor = load("rasterize", function="rasterize_from_points")(
        **_drawn(gaussians, camera, appearance, sh_degree),
        points=points,
        radius=radius.contiguous(),
        blur=blur.contiguous(),
        statistics=statistics,
    )
    return images


def _drawn(
    gaussians: Gaussians, camera: Camera, appearance: AppearanceOptions, sh_degree: int | None
) -> dict[str, Any]:
    """The arguments that both kernels share."""
    parameters = gaussians.parameters
    dark = not appearance.background
    return {
        **parameters,
        "camera": camera,
        "sh_degree": appearance.sh_degree if sh_degree is None else sh_degree,
        "filter_3d": gaussians.filter_3d if appearance.filter_3d else None,
        "filter_2d": appearance.filter_2d,
        "filter_2d_fades": appearance.filter_2d_fades,
        "near": gaussians.near,
        "background": None if dark else parameters["means"].new_full((3,), appearance.background),
    }
