"""One optimisation step on one photograph."""

from __future__ import annotations

from torch import Tensor

from dofbench.core.errors import InputError
from dofbench.training.common.image_losses import looked_at, reconstruction
from dofbench.training.common.nonfinite import Place
from dofbench.training.common.stage_clock import StageClock
from dofbench.training.common.training_views import Photograph
from dofbench.training.gaussians.forward.forward_model import SharpView
from dofbench.training.gaussians.step_rasteriser import StepRasteriser
from dofbench.training.gaussians.surface_terms import richest
from dofbench.training.gaussians.training_state import TrainingState

_FILTER_3D_EVERY = 100  # steps; Mip-Splatting's interval


def take_step(state: TrainingState, step: int, progress: float, view: Photograph, clock: StageClock) -> Tensor:
    """Take step number `step` (from 1) at `progress`, 0 to 1, on a photograph; returns the loss, without gradient.

    Raises NonFiniteError at the first value that isn't finite, before it can change a learned parameter. On a device
    such a value changes none either, but is told by `state.watch` when it is looked at.
    """
    place, model, adaptation = (
        Place(step, view.name, state.watch),
        state.forward.at(progress),
        state.adaptation(progress),
    )
    terms = [term for term in state.terms if term.acts(step, progress, view)]
    scene = StepRasteriser(state, progress, place, clock)
    geometry = richest([model.reads, state.reads(adaptation), *(term.reads for term in terms)])
    sharp = SharpView(lambda: scene.rasterise(view.camera, geometry))
    if model.looks or geometry != "none":
        _ = sharp.raster  # here, so that its time counts as rasterising and not as the lens's
    with clock.timed(model.stage), place.located(model.stage):
        shot = state.shot(view, sharp, adaptation)
        image = model.photograph(scene, sharp, shot)
        weight = adaptation.loss_weight(shot.out_of_focus(sharp.disparity)) if adaptation.active else None
    place.check(image, model.stage)

    with clock.timed("loss"):
        loss = _colour_loss(state, view, image, weight)
        if (own := model.cost(sharp, shot, view)) is not None:
            loss = loss + own
        if (own := state.density.cost()) is not None:
            loss = loss + own
        for term in terms:
            loss = loss + term.cost(sharp, view, progress, weight)
    place.check(loss, "loss")
    with clock.timed("loss and lens, backward"):
        loss.backward()
    scene.backward()
    _check_gradients(state, place)

    with clock.timed("optimiser"):
        _learn(state, progress, view)
    with clock.timed("density control"):
        state.density.record(scene.statistics(), view.camera.width, view.camera.height)
        changed = state.density.after_step(step, progress)
        if changed or step % _FILTER_3D_EVERY == 0:
            update_filter(state, place)
    return loss.detach()


def _colour_loss(state: TrainingState, view: Photograph, image: Tensor, weight: Tensor | None) -> Tensor:
    """The reconstruction loss, Eq. 7, on the pixels that aren't held back. weight: (H, W), that of the adaptation."""
    options, weigh_all = state.options.reconstruction, state.options.adaptation.adaptation_ssim
    image = state.colours.forward(view.index, image)
    image = looked_at(image, view.image, view.held_back, options.clipped_white)
    return reconstruction(image, view.image, options.ssim_weight, weight, weigh_all, options.edge_weight)


def _check_gradients(state: TrainingState, place: Place) -> None:
    for name, learned in state.learned().items():
        place.check(learned.gradient(), f"gradient by the {name}")
    for name, parameter in state.gaussians.parameters.items():
        place.check(parameter.grad, f"gradient by {name}")


def _learn(state: TrainingState, progress: float, view: Photograph) -> None:
    cooldown = state.options.schedule.cooldown(progress)
    state.optimiser.step(progress, cooldown, found_inf=state.watch.found)
    for learned in state.learned().values():
        learned.step(view.index, progress, cooldown)


def update_filter(state: TrainingState, place: Place) -> None:
    """Compute the 3D filter again. If no Gaussian is left in front of a camera, training has failed, which isn't the
    user's mistake: NonFiniteError."""
    try:
        state.gaussians.update_filter_3d(state.cameras)
    except InputError as error:
        raise place.error("density control", error.found) from None
