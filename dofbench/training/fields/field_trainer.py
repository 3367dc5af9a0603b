"""The training loop of all radiance fields."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.budget import Budget
from dofbench.core.contracts import FitOutcome, NonFinite, Observer, TrainingSet
from dofbench.core.errors import InputError, Status
from dofbench.runtime.compilation import compile_all
from dofbench.runtime.devices import kind_of
from dofbench.training.common.monitor import NonFiniteError, Place, ReportedLoss, StageClock, Watch
from dofbench.training.common.pace import Pace
from dofbench.training.common.photograph_colours import LearnedColours
from dofbench.training.fields.field_options import FieldOptions
from dofbench.training.fields.field_scene import FieldScene, Surroundings
from dofbench.training.fields.grid_field import GridField
from dofbench.training.fields.pixels import CameraTable, Pixels, TrainingPixels
from dofbench.training.fields.ray_model import Prediction, RayModel, RayTracer
from dofbench.training.fields.space import AnnealedSpace

_BETAS, _EPSILON = (0.9, 0.99), 1e-15  # TensoRF
_DRAWS, _DRAWN_BY = 4, 0  # predictions whose mean a predicted view is, and the seed of their rays
# Share of the training over which rates rise from 0 where views are from all around: with the whole rate from the start
# every camera may get a haze before it that never goes (docs/notes/fields.md).
_RISE = 0.1


# What a training that goes on makes anew, as it made it at first.
_MADE_ANEW = {"_options", "_pixels", "_device", "_pace", "_watch", "_reported", "_kept"}


class FieldTrainer:
    """Trains a field, and what its forward model learns, on a training set and a device.

    After `fit`, or during it from an observer, `scene` can be rendered at any time. colours: as learned so far. loss:
    of the last step, None before the first.
    """

    def __init__(
        self, training_set: TrainingSet, options: FieldOptions, model: RayModel, seed: int, device: str = "cpu"
    ):
        if training_set.points is None or len(training_set.points) < 4:
            found = 0 if training_set.points is None else len(training_set.points)
            raise InputError("sparse points", str(found), "at least 4, which give the scene's place")
        self._options, self._model, self._device = options, model, device
        self._generator = torch.Generator().manual_seed(seed)
        self._pixels = TrainingPixels(training_set.views, np.random.default_rng(seed), device)
        cameras = [view.camera for view in training_set.views]
        self._space = AnnealedSpace.of(cameras, training_set.points)
        space = self._space.whole
        shape = options.grid.shape(space.nodes(options.grid.nodes(0.0)))
        field = GridField.at_random(shape, options.grid.density_shift, self._generator, device)
        surroundings = Surroundings.grey(options.grid.surroundings_nodes, device) if space.has_surroundings else None
        self.scene = FieldScene(field, space, options, surroundings)
        self.colours = LearnedColours(len(cameras), options.colours, device)
        self._names = [view.name for view in training_set.views]
        self._tracer = RayTracer(self.scene, CameraTable(cameras, device), self._generator)
        self._optimiser = self._new_optimiser()
        self._clock = StageClock()
        self.loss: Tensor | None = None
        self._watch = Watch()
        self._reported = ReportedLoss(self._watch)
        self._step_number = 0
        self._pace: Pace | None = None  # of the training that is going on
        self._kept: dict[str, Any] | None = None  # of the pace in an earlier process, to go on from

    def fit(self, budget: Budget, observer: Observer) -> FitOutcome:
        """Train until the budget or the observer ends it. A non-finite value ends with the status "diverged"."""
        compile_all(sorted({"adam", "field", *self._model.kernels}), kind_of(self._device))
        pace = self._pace = Pace(budget, self._options.rays.steps, observer.seconds)
        probe = partial(self._time_of_a_step, observer)
        event: NonFinite | None = None
        try:
            self._pixels.check(step=1)
            if self._kept is None:
                pace.plan(self._options.starts(), probe, again=False)
            else:
                pace.restore(self._kept, probe)
            while (progress := pace.progress(self._step_number)) < 1:
                self.loss = self._step(self._step_number + 1, progress)
                self._step_number += 1
                if not observer.after_step(self._step_number, self._reported.after(self._step_number, self.loss)):
                    break
            self._watch.look()
        except NonFiniteError as error:
            event = error.event
            self._step_number = max(self._step_number, event.step)  # the step that failed counts as taken
            self._optimiser.zero_grad()
        return FitOutcome(
            status=Status.DIVERGED if event else Status.OK,
            steps=self._step_number,
            message=str(event) if event else "",
            nonfinite=(event,) if event else (),
            stages=dict(self._clock.seconds),
        )

    def training_state(self) -> dict[str, Any]:
        """Everything that training has changed so far, to be asked for by an observer of a step, and to be pickled: the
        objects themselves, not copies."""
        assert self._pace is not None
        self._watch.look()
        own = {name: value for name, value in vars(self).items() if name not in _MADE_ANEW}
        return {"own": own, "pixels": self._pixels.state(), "pace": self._pace.state()}

    def resume_from(self, kept: dict[str, Any]) -> None:
        """Let `fit` go on from the state of an earlier process; on a CPU the rest is the same to the bit."""
        vars(self).update(kept["own"])
        self._pixels.restore(kept["pixels"])
        self._kept = kept["pace"]

    def _time_of_a_step(self, observer: Observer, progress: float) -> float:
        """Seconds of a step at `progress`, by a copy of the training before its first step."""
        twin, start = copy.deepcopy(self), observer.seconds()
        float(twin._step(1, progress))  # waits for a device
        return observer.seconds() - start

    def _step(self, step: int, progress: float) -> Tensor:
        """Take step number `step`, from 1; returns the loss, without gradient.

        Raises NonFiniteError at the first value that isn't finite, before it can change the field. On a device such a
        value doesn't change the field either, but the watch reports it later.
        """
        place, options = Place(step, "", self._watch), self._options
        self._grow(progress)
        self.scene.space = self._space.at(progress)
        with self._clock.timed("cells"):
            if progress >= options.rays.cells_from and step % options.rays.cells_every == 0:
                self.scene.look_for_empty_cells(self._generator)
        pixels = self._model.draw(self._pixels, options.rays.batch_pixels, progress)
        with self._clock.timed(self._model.stage), place.located(self._model.stage):
            predictions = self._model.predict(self._tracer, pixels, progress)
        for prediction in predictions:
            place.check(prediction.colours, self._model.stage)
        with self._clock.timed("loss"):
            loss = self._cost(predictions, pixels, step, progress)
        place.check(loss, "loss")
        with self._clock.timed("backward"):
            loss.backward()
        own = {name: tensor.grad for name, tensor in self.scene.parameters.items()}
        learned = {**self._model.gradients(), "colours": self.colours.gradient()}
        for name, gradient in {**own, **learned}.items():
            place.check(gradient, f"gradient with respect to {name}")
        with self._clock.timed("optimiser"):
            rise = min(1, progress / _RISE) if self.scene.space.has_surroundings else 1
            for group in self._optimiser.param_groups:
                group["lr"] = group["first"] * options.rates.lr_final**progress * rise
            self._optimiser.found_inf = self._watch.found  # type: ignore[attr-defined]  # 1 has it change nothing
            self._optimiser.step()
            self._optimiser.zero_grad()
            self._model.step(progress)
            self.colours.step(pixels.view, progress)
        return loss.detach()

    def _cost(self, predictions: Sequence[Prediction], pixels: Pixels, step: int, progress: float) -> Tensor:
        """Mean squared errors, the forward model's own term, and at intervals the roughness of the grid."""
        rates = self._options.rates
        colours = torch.stack([one.colours for one in predictions])
        if pixels.view is not None:
            colours = self.colours.forward(pixels.view, colours)
        else:
            colours = self.colours.of_pixels(pixels.views, colours)
        shown = pixels.without_masked(colours)
        weights = [one.weight for one in predictions]
        errors = [weight * (one - pixels.colours).square().mean() for weight, one in zip(weights, shown, strict=True)]
        loss = torch.stack(errors).sum()
        if (own := self._model.cost(progress)) is not None:
            loss = loss + own
        if step % rates.smooth_every == 0:
            rough = self.scene.field.roughness()
            smooth = rates.density_smooth * rough["density"] + rates.colour_smooth * rough["colour"]
            loss = loss + rates.smooth_every * smooth
        return loss

    @torch.no_grad()
    def predict_view(self, view: int, asked: np.ndarray) -> np.ndarray:
        """(H, W, 3), encoded: predict training view number `view` by the forward model and its learned colours.

        asked: (H, W) bool, the pixels that have to be right. Rays are drawn at random as in training: the mean of
        `_DRAWS` predictions, from the same numbers in every call.
        """
        pixels, chosen = self._pixels.whole_view(view), torch.from_numpy(asked.reshape(-1)).to(self._device)
        tracer = RayTracer(self.scene, self._tracer.cameras, torch.Generator().manual_seed(_DRAWN_BY))
        draws = [self._model.predict_view(tracer, pixels, chosen) for _ in range(_DRAWS)]
        colours = self.colours.of_pixels(pixels.views, torch.stack(draws).mean(0))
        return colours.view(*asked.shape, 3).numpy(force=True)

    def colour_estimates(self) -> dict[str, np.ndarray] | None:
        """See `LearnedColours.estimates`."""
        return self.colours.estimates(self._names)

    def _grow(self, progress: float) -> None:
        """Resize the grid to its nodes at `progress`; the optimiser then begins anew, as in TensoRF."""
        options, field = self._options.grid, self.scene.field
        shape = options.shape(self.scene.space.nodes(options.nodes(progress)))
        if shape != field.shape:
            self.scene.field = field.resized(shape)
            self._optimiser = self._new_optimiser()

    def _new_optimiser(self) -> torch.optim.Adam:
        rates, parameters = self._options.rates, self.scene.parameters
        basis = parameters.pop("basis")
        groups = [
            {"params": list(parameters.values()), "first": rates.grid_lr},
            {"params": [basis], "first": rates.basis_lr},
        ]
        return torch.optim.Adam(groups, betas=_BETAS, eps=_EPSILON, fused=True)
