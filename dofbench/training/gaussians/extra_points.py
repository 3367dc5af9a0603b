"""Points added once in the course of the training (Deblurring 3D Gaussian Splatting, section 3.4; CoCoGaussian has the
same), since structure from motion finds few in blurred images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from dofbench.runtime.device_numbers import beside
from dofbench.training.gaussians.density import DensityControl, DensityOptions
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import INITIAL_OPACITY, Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser

_OUTERMOST = 10  # points on each side of each axis that the box excludes
_NEIGHBOURS = 4


@dataclass(frozen=True)
class ExtraOptions:
    """How many points are added, when, and where."""

    extra_points: int = 0
    """Number of points drawn evenly in the box of the Gaussians' means; those far from all means aren't used; 0 for
    none. Unit: none. Source: Deblurring-3DGS: the box's volume in scene units over 1.33, at most 200 000."""
    extra_at: float = 0.125
    """When they are added. Unit: share of the training. Source: Deblurring-3DGS, step 2500 of 20 000."""
    extra_within: float = 10.0
    """Distance from the nearest mean up to which a point is used. Unit: median distance of neighbouring means. Source:
    own; 2 scene units in Deblurring-3DGS."""


@dataclass(frozen=True)
class GrownOnceOptions(GaussianOptions):
    """The trainer's options, and those of points that are added once."""

    extra: ExtraOptions = ExtraOptions()

    def density_control(
        self, gaussians: Gaussians, optimiser: GaussianOptimiser, extent: float, generator: torch.Generator
    ) -> DensityControl:
        return GrowingOnce(gaussians, optimiser, self.density, self.extra, extent, generator)


class GrowingOnce(DensityControl):
    """Density control by gradients, and points added once; then all scales, rotations and opacities begin anew, as
    published."""

    def __init__(
        self,
        gaussians: Gaussians,
        optimiser: GaussianOptimiser,
        options: DensityOptions,
        extra: ExtraOptions,
        extent: float,
        generator: torch.Generator,
    ):
        super().__init__(gaussians, optimiser, options, extent, generator)
        self._extra, self._added = extra, extra.extra_points <= 0

    def state(self) -> tuple[Tensor, Tensor, float, bool]:  # type: ignore[override]  # what a snapshot keeps of it
        return (*super().state(), self._added)

    def restore(self, state: tuple[Tensor, Tensor, float, bool]) -> None:  # type: ignore[override]
        super().restore(state[:3])
        self._added = state[3]

    def after_step(self, step: int, progress: float) -> bool:
        """As `DensityControl.after_step`, and True when the points were added."""
        due = not self._added and not self.pace.resting and progress >= self._extra.extra_at
        if due:
            self._add()
            self._clear()
        return super().after_step(step, progress) or due

    @torch.no_grad()
    def _add(self) -> None:
        self._added = True
        parameters = {name: value.detach() for name, value in self._gaussians.parameters.items()}
        places, colours = draw_between(parameters["means"], parameters["sh_dc"], self._extra, self._generator)
        count = len(places)
        added = {name: value.new_zeros(count, *value.shape[1:]) for name, value in parameters.items()}
        added["means"], added["sh_dc"] = places, colours
        kept = torch.arange(len(self._gaussians), device=places.device)
        self._optimiser.rebuild(kept, added)
        means = self._gaussians.parameters["means"].detach()
        scales = neighbour_distances(means)[0].square().mean(dim=1).sqrt().clamp_min(1e-7)
        opacity = means.new_full((len(means),), INITIAL_OPACITY)
        identity = beside(means, [1.0, 0.0, 0.0, 0.0]).expand(len(means), 4)
        for name, value in (
            ("log_scales", scales.log()[:, None].expand(-1, 3)),
            ("quaternions", identity),
            ("opacity_logits", torch.logit(opacity)),
        ):
            self._optimiser.replace(name, value)
        self._optimiser.forget(torch.arange(len(means), device=means.device))


def draw_between(
    means: Tensor, colours: Tensor, options: ExtraOptions, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw places (M, 3) evenly in the box of the means (N, 3), near some of them, and their colours (M, 3).

    A colour is the mean of the four nearest ones' (N, 3), each weighted by its distance, as published: the farther the
    more.
    """
    outermost = min(_OUTERMOST, (len(means) - 1) // 2)
    ordered = means.sort(dim=0).values
    low, high = ordered[outermost], ordered[len(means) - 1 - outermost]
    # The generator is the host's, so that a seed draws the same places on every device.
    drawn = torch.rand(options.extra_points, 3, generator=generator, device=generator.device)
    places = low + (high - low) * drawn.to(means.device)
    spacing = neighbour_distances(means)[0][:, 0].median()
    distances, nearest = _nearest(means, places, _NEIGHBOURS)
    near = distances[:, 0] < options.extra_within * spacing
    distances, nearest = distances[near], nearest[near]
    weights = distances / distances.sum(dim=1, keepdim=True).clamp_min(1e-12)
    return places[near], (weights[..., None] * colours[nearest]).sum(dim=1)


def neighbour_distances(means: Tensor) -> tuple[Tensor, Tensor]:
    """(N, 3) distances of each mean's three nearest others, ascending, and their indices."""
    distances, nearest = _nearest(means, means, _NEIGHBOURS)
    return distances[:, 1:], nearest[:, 1:]


def _nearest(means: Tensor, places: Tensor, count: int) -> tuple[Tensor, Tensor]:
    from scipy.spatial import cKDTree

    # One thread: the same search gives the same order of equal distances.
    distances, index = cKDTree(means.numpy(force=True)).query(places.numpy(force=True), k=count)
    found = np.atleast_2d(distances).astype(np.float32)
    return torch.from_numpy(found).to(means.device), torch.from_numpy(np.atleast_2d(index)).to(means.device)
