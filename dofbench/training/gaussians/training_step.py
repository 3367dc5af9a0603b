"""One optimisation step on one view, and its rasterisations."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.runtime.raster import Geometry, Raster, ViewStatistics
from dofbench.training.common.losses import reconstruction, without_held_out
from dofbench.training.common.monitor import Place, StageClock
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import SharpView
from dofbench.training.gaussians.render import rasterise, rasterise_from_points
from dofbench.training.gaussians.surface_terms import richest
from dofbench.training.gaussians.training_state import TrainingState

_STAGE = "rasterise"
_FILTER_3D_EVERY = 100  # steps; Mip-Splatting's interval


class StepRasteriser:
    """The `Rasteriser` of one training step at `progress`, 0 to 1.

    Its rasters are leaves of the autograd graph: gradients stop there until `backward` passes them on to the Gaussians.
    So each part of the step is timed by itself, and gradients are checked before they reach the Gaussians.
    """

    def __init__(self, state: TrainingState, progress: float, place: Place, clock: StageClock):
        self.gaussians, self._random = state.gaussians, state.random
        self._appearance, self._want_abs = state.options.appearance, state.options.density.grow_absolute
        self._degree = self._appearance.degree(progress)
        self._place, self._clock = place, clock
        self._statistics: list[ViewStatistics] = []
        self._cut: list[tuple[Tensor, Tensor]] = []

    def rasterise(self, camera: Camera, geometry: Geometry) -> Raster:
        raster = self._raster(camera, geometry)
        return Raster._make(None if output is None else self._leaf(output) for output in raster)

    def rasterise_with(self, camera: Camera, parameters: Mapping[str, Tensor]) -> Tensor:
        return self._leaf(self._raster(camera, "none", parameters).color)

    def rasterise_from_points(self, camera: Camera, points: np.ndarray, radius: Tensor, blur: Tensor) -> Tensor:
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
        return self._random.uniform(0, 2 * math.pi)

    def backward(self) -> None:
        """Pass the gradients at the leaves on to the Gaussians. Raises NonFiniteError for one that isn't finite."""
        reached = [(output, leaf.grad) for output, leaf in self._cut if leaf.grad is not None]
        for _, gradient in reached:
            self._place.check(gradient, "gradient with respect to the rendering")
        with self._clock.timed(f"{_STAGE}, backward"):
            torch.autograd.backward([output for output, _ in reached], [gradient for _, gradient in reached])

    def statistics(self) -> ViewStatistics:
        """The statistics of all rasterisations that gradients passed through, as if of one."""
        return summed([one for one in self._statistics if one.grad_2d is not None])


def summed(statistics: list[ViewStatistics]) -> ViewStatistics:
    """Combine the statistics of several rasterisations of one view: their gradients are added."""
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


def take_step(state: TrainingState, step: int, progress: float, view: ScaledView, clock: StageClock) -> Tensor:
    """Take step number `step` (from 1) at `progress`, 0 to 1, on a view; returns the loss, without gradient.

    Raises NonFiniteError at the first value that isn't finite, before it can change a learned parameter. On a device
    such a value changes none either, but `state.watch` reports it later.
    """
    place, model = Place(step, view.name, state.watch), state.forward.at(progress)
    adaptation = state.adaptation(progress)
    terms = [term for term in state.terms if term.acts(step, progress, view)]
    scene = StepRasteriser(state, progress, place, clock)
    geometry = richest([model.reads, state.reads(adaptation), *(term.reads for term in terms)])
    sharp = SharpView(lambda: scene.rasterise(view.camera, geometry))
    if model.needs_sharp_render or geometry != "none":
        _ = sharp.raster  # here, so that its time counts as rasterising and not as the lens's
    with clock.timed(model.stage), place.located(model.stage):
        shot = state.shot(view, sharp, adaptation)
        image = model.render(scene, sharp, shot)
        weight = adaptation.loss_weight(shot.out_of_focus(sharp.disparity)) if adaptation.active else None
    place.check(image, model.stage)

    with clock.timed("loss"):
        loss = _colour_loss(state, view, image, weight)
        for own in (model.cost(sharp, shot, view), state.density.cost()):
            if own is not None:
                loss = loss + own
        for term in terms:
            loss = loss + term.cost(sharp, view, progress, weight)
    place.check(loss, "loss")
    with clock.timed("loss and lens, backward"):
        loss.backward()
    scene.backward()
    _check_gradients(state, place)

    with clock.timed("optimiser"):
        _update(state, progress, view)
    with clock.timed("density control"):
        state.density.record(scene.statistics(), view.camera.width, view.camera.height)
        changed = state.density.after_step(step, progress)
        if changed or step % _FILTER_3D_EVERY == 0:
            update_filter(state, place)
    return loss.detach()


def _colour_loss(state: TrainingState, view: ScaledView, image: Tensor, weight: Tensor | None) -> Tensor:
    """The reconstruction loss, Eq. 7, except on held-out pixels. weight: (H, W), that of the adaptation."""
    options, weigh_all = state.options.reconstruction, state.options.adaptation.adaptation_ssim
    image = state.colours.forward(view.index, image)
    image = without_held_out(image, view.image, view.held_back, options.clipped_white)
    return reconstruction(image, view.image, options.ssim_weight, weight, weigh_all, options.edge_weight)


def _check_gradients(state: TrainingState, place: Place) -> None:
    for name, learned in state.learned().items():
        place.check(learned.gradient(), f"gradient with respect to the {name}")
    for name, parameter in state.gaussians.parameters.items():
        place.check(parameter.grad, f"gradient with respect to {name}")


def _update(state: TrainingState, progress: float, view: ScaledView) -> None:
    schedule = state.options.schedule
    cooldown = schedule.cooldown(progress)
    state.optimiser.step(schedule.rate_progress(progress), cooldown, found_inf=state.watch.found)
    for learned in state.learned().values():
        learned.step(view.index, progress, cooldown)


def update_filter(state: TrainingState, place: Place) -> None:
    """Compute the 3D filter again. Raises NonFiniteError if no Gaussian is left in front of a camera: then training has
    failed, which isn't the user's mistake."""
    try:
        state.gaussians.update_filter_3d(state.cameras)
    except InputError as error:
        raise place.error("density control", error.found) from None
