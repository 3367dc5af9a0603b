"""What one training step rasterises: with statistics for density control, and with the graph of gradients cut."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dofbench.compute.raster import Geometry, Raster, ViewStatistics
from dofbench.core.cameras import Camera
from dofbench.gaussians.render import rasterise
from dofbench.gaussians.stage_clock import StageClock
from dofbench.gaussians.training_state import TrainingState
from dofbench.learning.nonfinite import Place

_STAGE = "rasterise"


class StepRasteriser:
    """The `Rasteriser` of one training step at `progress`, 0 to 1.

    What it gives out are leaves: gradients stop at them until `backward` passes them on to the Gaussians. So each part
    of the step has its own time, and its numbers can be looked at before they do harm.
    """

    def __init__(self, state: TrainingState, progress: float, place: Place, clock: StageClock):
        self.gaussians, self._random = state.gaussians, state.random
        self._appearance, self._want_abs = state.options.appearance, state.options.density.grow_absolute
        self._degree = self._appearance.degree(progress)
        self._place, self._clock = place, clock
        self._statistics: list[ViewStatistics] = []
        self._cut: list[tuple[Tensor, Tensor]] = []

    def rasterise(
        self, camera: Camera, geometry: Geometry, *, means: Tensor | None = None, blur: Tensor | None = None
    ) -> Raster:
        """One sharp view, with gradient from all its outputs."""
        statistics = ViewStatistics(want_abs=self._want_abs)
        with self._clock.timed(_STAGE), self._place.located(_STAGE):
            raster = rasterise(
                self.gaussians,
                camera,
                self._appearance,
                sh_degree=self._degree,
                geometry=geometry,
                statistics=statistics,
                means=means,
                blur=blur,
            )
        self._statistics.append(statistics)
        leaves = [None if output is None else output.detach().requires_grad_() for output in raster]
        self._cut += [(output, leaf) for output, leaf in zip(raster, leaves, strict=True) if leaf is not None]
        return Raster(*leaves)

    def turn(self) -> float:
        """Any angle, radians."""
        return self._random.uniform(0, 2 * math.pi)

    def backward(self) -> None:
        """Pass the gradients that reached the leaves on to the Gaussians. Raises NonFiniteError for a bad one."""
        reached = [(output, leaf.grad) for output, leaf in self._cut if leaf.grad is not None]
        for _, gradient in reached:
            self._place.check(gradient, "gradient by the rendering")
        with self._clock.timed(f"{_STAGE}, backward"):
            torch.autograd.backward([output for output, _ in reached], [gradient for _, gradient in reached])

    def statistics(self) -> ViewStatistics:
        """Of all that gradients passed through, as of one photograph."""
        return summed([one for one in self._statistics if one.grad_2d is not None])


def summed(statistics: list[ViewStatistics]) -> ViewStatistics:
    """Statistics of several renderings as those of one: gradients add up, as the photograph's does."""
    whole = ViewStatistics(want_abs=statistics[0].want_abs)
    whole.visible = torch.stack([one.visible for one in statistics]).any(dim=0)
    whole.radii = torch.stack([one.radii for one in statistics]).amax(dim=0)
    whole.grad_2d = torch.stack([one.grad_2d for one in statistics]).sum(dim=0)
    if whole.want_abs:
        whole.abs_grad_2d = torch.stack([one.abs_grad_2d for one in statistics]).sum(dim=0)
    return whole
