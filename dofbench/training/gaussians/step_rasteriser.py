"""The rasterisations of one training step: they keep statistics for density control, and cut the autograd graph."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.raster import Geometry, Raster, ViewStatistics
from dofbench.training.common.nonfinite import Place
from dofbench.training.common.stage_clock import StageClock
from dofbench.training.gaussians.render import rasterise, rasterise_from_points
from dofbench.training.gaussians.training_state import TrainingState

_STAGE = "rasterise"


class StepRasteriser:
    """The `Rasteriser` of one training step at `progress`, 0 to 1.

    The rasters that it returns are leaves of the autograd graph: gradients stop there until `backward` passes them on
    to the Gaussians. So each part of the step is timed by itself, and gradients are checked before they reach the
    Gaussians.
    """

    def __init__(self, state: TrainingState, progress: float, place: Place, clock: StageClock):
        self.gaussians, self._random = state.gaussians, state.random
        self._appearance, self._want_abs = state.options.appearance, state.options.density.grow_absolute
        self._degree = self._appearance.degree(progress)
        self._place, self._clock = place, clock
        self._statistics: list[ViewStatistics] = []
        self._cut: list[tuple[Tensor, Tensor]] = []

    def rasterise(self, camera: Camera, geometry: Geometry) -> Raster:
        """One sharp view, all outputs of which collect gradients."""
        raster = self._raster(camera, geometry)
        return Raster(
            color=self._leaf(raster.color),
            alpha=self._leaf(raster.alpha),
            depth=None if raster.depth is None else self._leaf(raster.depth),
            median_depth=None if raster.median_depth is None else self._leaf(raster.median_depth),
            normal=None if raster.normal is None else self._leaf(raster.normal),
            distortion=None if raster.distortion is None else self._leaf(raster.distortion),
        )

    def changed(self, camera: Camera, parameters: Mapping[str, Tensor]) -> Tensor:
        """(H, W, 3), a view with some parameters replaced, which collects gradients."""
        return self._leaf(self._raster(camera, "none", parameters).color)

    def from_points(self, camera: Camera, points: np.ndarray, radius: Tensor, blur: Tensor) -> Tensor:
        """(P, H, W, 3) as seen from points of the lens, which collect gradients."""
        statistics = self._watched()
        with self._clock.timed(_STAGE), self._place.located(_STAGE):
            images = rasterise_from_points(
                self.gaussians,
                camera,
                self._appearance,
                points,
                radius,
                blur,
                sh_degree=self._degree,
                statistics=statistics,
            )
        return self._leaf(images)

    def _raster(self, camera: Camera, geometry: Geometry, changes: Mapping[str, Tensor] | None = None) -> Raster:
        statistics = self._watched()
        with self._clock.timed(_STAGE), self._place.located(_STAGE):
            return rasterise(
                self.gaussians,
                camera,
                self._appearance,
                sh_degree=self._degree,
                geometry=geometry,
                statistics=statistics,
                changes=changes,
            )

    def _watched(self) -> ViewStatistics:
        self._statistics.append(ViewStatistics(want_abs=self._want_abs))
        return self._statistics[-1]

    def _leaf(self, output: Tensor) -> Tensor:
        leaf = output.detach().requires_grad_()
        self._cut.append((output, leaf))
        return leaf

    def turn(self) -> float:
        """A random angle by which the pattern of lens points is rotated, radians."""
        return self._random.uniform(0, 2 * math.pi)

    def backward(self) -> None:
        """Pass the gradients at the leaves on to the Gaussians. Raises NonFiniteError for a gradient that isn't
        finite."""
        reached = [(output, leaf.grad) for output, leaf in self._cut if leaf.grad is not None]
        for _, gradient in reached:
            self._place.check(gradient, "gradient by the rendering")
        with self._clock.timed(f"{_STAGE}, backward"):
            torch.autograd.backward([output for output, _ in reached], [gradient for _, gradient in reached])

    def statistics(self) -> ViewStatistics:
        """Statistics of all rasterisations that gradients passed through, combined as if they were one photograph's."""
        return summed([one for one in self._statistics if one.grad_2d is not None])


def summed(statistics: list[ViewStatistics]) -> ViewStatistics:
    """Statistics of several rasterisations of one photograph as those of one: their gradients are added."""
    if len(statistics) == 1:
        return statistics[0]
    whole = ViewStatistics(want_abs=statistics[0].want_abs)
    whole.visible = _stacked([one.visible for one in statistics]).any(dim=0)
    whole.radii = _stacked([one.radii for one in statistics]).amax(dim=0)
    whole.grad_2d = _stacked([one.grad_2d for one in statistics]).sum(dim=0)
    if whole.want_abs:
        whole.abs_grad_2d = _stacked([one.abs_grad_2d for one in statistics]).sum(dim=0)
    return whole


def _stacked(tensors: list[Tensor | None]) -> Tensor:
    there = [tensor for tensor in tensors if tensor is not None]
    assert len(there) == len(tensors)  # after a backward pass nothing is missing
    return torch.stack(there)
