"""The terms of the loss that concern surfaces instead of colours: known depth, normals, distortion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from torch import Tensor

from dofbench.runtime.raster import GEOMETRIES, Geometry
from dofbench.training.common.depth import SupervisionOptions, depth_loss
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import SharpView
from dofbench.training.gaussians.surface_losses import (
    DistortionOptions,
    NormalOptions,
    distortion_loss,
    normal_consistency,
)


class SurfaceTerm(Protocol):
    """A term of the loss. reads: the geometry that the term needs of the sharp view."""

    reads: Geometry

    def acts(self, step: int, progress: float, view: ScaledView) -> bool:
        """Whether the term is used in step number `step` (from 1) at `progress`, 0 to 1, for this photograph."""

    def cost(self, sharp: SharpView, view: ScaledView, progress: float, weight: Tensor | None) -> Tensor:
        """The term's contribution to the loss. weight: (H, W), that of the adaptation, or None."""


class KnownDepth:
    """Depth supervision, Eq. 9. extent: width of the disparity range that normalised disparity refers to, 1 / scene
    unit."""

    reads: Geometry = "depth"

    def __init__(self, options: SupervisionOptions, extent: float):
        self._options, self._extent = options, extent

    def acts(self, step: int, progress: float, view: ScaledView) -> bool:
        """True for photographs with known depth, in every `depth_every`-th step."""
        return view.known is not None and step % self._options.depth_every == 0

    def cost(self, sharp: SharpView, view: ScaledView, progress: float, weight: Tensor | None) -> Tensor:
        """The weighted depth loss."""
        raster = sharp.raster
        assert raster.depth is not None and view.known is not None
        found = depth_loss(raster.depth, raster.alpha, view.known, self._options, self._extent, weight)
        # Taken more rarely, the term weighs as much more, so that its share of the training stays the same.
        return self._options.depth_every * self._options.weight_at(progress) * found


class Normals:
    """Normal consistency, Eq. 12."""

    reads: Geometry = "full"

    def __init__(self, options: NormalOptions):
        self._options = options

    def acts(self, step: int, progress: float, view: ScaledView) -> bool:
        """True from `normal_from` on."""
        return progress >= self._options.normal_from

    def cost(self, sharp: SharpView, view: ScaledView, progress: float, weight: Tensor | None) -> Tensor:
        """The weighted loss over the whole view; the adaptation's weight isn't used."""
        options, raster = self._options, sharp.raster
        assert raster.normal is not None and raster.depth is not None and raster.median_depth is not None
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
    """The distortion loss of the released code."""

    reads: Geometry = "distortion"

    def __init__(self, options: DistortionOptions):
        self._options = options

    def acts(self, step: int, progress: float, view: ScaledView) -> bool:
        """True from `distortion_from` on."""
        return progress >= self._options.distortion_from

    def cost(self, sharp: SharpView, view: ScaledView, progress: float, weight: Tensor | None) -> Tensor:
        """The weighted loss over the whole view; the adaptation's weight isn't used."""
        options, raster = self._options, sharp.raster
        assert raster.distortion is not None
        return options.distortion_weight * distortion_loss(
            raster.distortion, raster.alpha, view.image, options.distortion_near, options.distortion_far
        )


def surface_terms(
    supervision: SupervisionOptions, normals: NormalOptions, distortion: DistortionOptions, extent: float
) -> list[SurfaceTerm]:
    """The terms with a weight above 0, in the order in which they are added up. extent: see `KnownDepth`."""
    terms: list[tuple[float, SurfaceTerm]] = [
        (supervision.depth_weight, KnownDepth(supervision, extent)),
        (normals.normal_weight, Normals(normals)),
        (distortion.distortion_weight, Distortion(distortion)),
    ]
    return [term for weight, term in terms if weight > 0]


def richest(geometries: Iterable[Geometry]) -> Geometry:
    """The geometry that includes all of these."""
    return max(geometries, key=GEOMETRIES.index, default="none")
