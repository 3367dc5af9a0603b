"""The terms of the loss that look at surfaces, not at colours: known depth, normals, distortion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from torch import Tensor

from dofbench.compute.raster import GEOMETRIES, Geometry
from dofbench.gaussians.distortion import DistortionOptions, distortion_loss
from dofbench.gaussians.forward.forward_model import SharpView
from dofbench.gaussians.normals import NormalOptions, normal_consistency
from dofbench.learning.depth_loss import SupervisionOptions, depth_loss
from dofbench.learning.training_views import Photograph


class SurfaceTerm(Protocol):
    """A term of the loss. reads: the geometry that the sharp view must hold for it."""

    reads: Geometry

    def acts(self, progress: float, view: Photograph) -> bool:
        """Whether it counts at `progress`, 0 to 1, on this photograph."""

    def cost(self, sharp: SharpView, view: Photograph, progress: float, weight: Tensor | None) -> Tensor | None:
        """What it adds to the loss, None for nothing. weight: (H, W), the adaptation's, or None."""


class KnownDepth:
    """Eq. 9. extent: 1 / scene unit, that of the range which normalised disparity refers to."""

    reads: Geometry = "depth"

    def __init__(self, options: SupervisionOptions, extent: float):
        self._options, self._extent = options, extent

    def acts(self, progress: float, view: Photograph) -> bool:
        """On photographs of which depth is known."""
        return view.known is not None

    def cost(self, sharp: SharpView, view: Photograph, progress: float, weight: Tensor | None) -> Tensor | None:
        """None where no known pixel has a surface yet."""
        raster = sharp.raster
        found = depth_loss(raster.depth, raster.alpha, view.known, self._options, self._extent, weight)
        return None if found is None else self._options.weight_at(progress) * found


class Normals:
    """Eq. 12."""

    reads: Geometry = "full"

    def __init__(self, options: NormalOptions):
        self._options = options

    def acts(self, progress: float, view: Photograph) -> bool:
        """From `normal_from` on."""
        return progress >= self._options.normal_from

    def cost(self, sharp: SharpView, view: Photograph, progress: float, weight: Tensor | None) -> Tensor:
        """Over the whole view, whatever is in focus."""
        options, raster = self._options, sharp.raster
        return options.normal_weight * normal_consistency(
            raster.normal,
            raster.alpha,
            raster.depth,
            raster.median_depth,
            view.camera,
            options.normal_median,
            options.normal_form,
        )


class Distortion:
    """The released code's."""

    reads: Geometry = "distortion"

    def __init__(self, options: DistortionOptions):
        self._options = options

    def acts(self, progress: float, view: Photograph) -> bool:
        """From `distortion_from` on."""
        return progress >= self._options.distortion_from

    def cost(self, sharp: SharpView, view: Photograph, progress: float, weight: Tensor | None) -> Tensor:
        """Over the whole view, whatever is in focus."""
        options, raster = self._options, sharp.raster
        return options.distortion_weight * distortion_loss(
            raster.distortion, raster.alpha, view.image, options.distortion_near, options.distortion_far
        )


def surface_terms(
    supervision: SupervisionOptions, normals: NormalOptions, distortion: DistortionOptions, extent: float
) -> list[SurfaceTerm]:
    """The terms that have a weight, in the order in which they are added up. extent: as `KnownDepth` takes it."""
    terms: list[tuple[float, SurfaceTerm]] = [
        (supervision.depth_weight, KnownDepth(supervision, extent)),
        (normals.normal_weight, Normals(normals)),
        (distortion.distortion_weight, Distortion(distortion)),
    ]
    return [term for weight, term in terms if weight > 0]


def richest(geometries: Iterable[Geometry]) -> Geometry:
    """The geometry that holds what all of these do."""
    return max(geometries, key=GEOMETRIES.index, default="none")
