"""The training loop that every Gaussian method of this project shares."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import (
    Decision,
    FitOutcome,
    NonFinite,
    Observer,
    Rendering,
    TrainingSet,
)
from dofbench.core.errors import Ended, InputError, Status
from dofbench.core.lens import PhysicalLens
from dofbench.runtime.device_memory import would_fit
from dofbench.training.common.held_back import HeldBackScores, held_back_scores
from dofbench.training.common.lenses import LearnedLenses
from dofbench.training.common.nonfinite import NonFiniteError, Place
from dofbench.training.common.photograph_colours import LearnedColours
from dofbench.training.common.priors import Prior, make_prior, with_surface_points
from dofbench.training.common.rendered_surface import surface_disparity
from dofbench.training.common.seen_loss import SeenLoss
from dofbench.training.common.stage_clock import StageClock
from dofbench.training.common.training_views import Photograph, all_photographs
from dofbench.training.gaussians.blur_circles import foci_apart, widest_circle
from dofbench.training.gaussians.exposure import StillRasteriser, render_view
from dofbench.training.gaussians.forward.forward_model import SharpView
from dofbench.training.gaussians.forward.shot import Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.training_state import Snapshot, TrainingState
from dofbench.training.gaussians.training_step import take_step, update_filter
from dofbench.training.gaussians.trials import HELD_BACK, MOST_TIME, Left, Trials, possible_models, unlimited
from dofbench.training.gaussians.warmup import compile_kernels

_PACE = 3  # steps of a trial that tell how long the rest will take


class Trainer:
    """Trains Gaussians, and with the option `lens` a lens per view, on a training set.

    After `fit`, or during it from an observer, `render` and `lens_estimates` work at any time.
    """

    def __init__(self, training_set: TrainingSet, options: GaussianOptions, seed: int, device: str = "cpu"):
        self.state = TrainingState(training_set, options, seed, device)
        self.views = training_set.views
        self.decisions: list[Decision] = []
        self._training_set, self._seed, self._device = training_set, seed, device
        self._seen = SeenLoss(self.state.watch)
        self._clock = StageClock()
        self._trials = Trials(self, options)
        self._prior: Prior | None = None
        self._photographs: dict[int, list[Photograph]] = {}

    @property
    def options(self) -> GaussianOptions:
        """The current options, which trials may have revised since training began."""
        return self.state.options

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians being trained; always the same object."""
        return self.state.gaussians

    @property
    def lenses(self) -> LearnedLenses | None:
        """The lenses as learned so far; None for a training without lenses."""
        return self.state.lenses

    @property
    def colours(self) -> LearnedColours:
        """The photographs' colours as learned so far."""
        return self.state.colours

    @property
    def left_out_views(self) -> set[int]:
        """Numbers of the views that were found not to belong to the scene (option `outlier_views`)."""
        return self.state.order.left_out

    @property
    def stages(self) -> dict[str, float]:
        """Seconds by part of the training."""
        return self._clock.seconds

    def fit(self, budget: Budget, observer: Observer) -> FitOutcome:
        """Train until the budget or the observer ends it. A non-finite value, or no Gaussian left in front of the
        cameras, ends with the status "diverged". Raises Ended, which says how many Gaussians would fit, where a
        device's memory isn't enough."""
        geometries = [term.reads for term in self.state.terms]
        from_points = any(model.from_points for model in (*possible_models(self.options), *self.state.forward.models))
        more = () if self.state.blur is None else self.state.blur.kernels
        compile_kernels(self.gaussians, self.state.cameras[0], self.options, geometries, from_points, more)
        preset = self.options.schedule.steps
        step, event = 0, None
        try:
            with self._clock.timed("depth prior"):
                self._prepare(budget.steps or preset, observer)
            self._photographs = self._all_photographs()
            while (progress := budget.progress(step, preset, observer.seconds)) < 1:
                if self._trials.due(step, progress):
                    step = self._decide(step, progress, budget, observer)
                else:
                    self._next(step, progress)
                    step += 1
                if not observer.after_step(step, self._seen_loss(step)):
                    break
            self.state.watch.look()
        except NonFiniteError as error:
            event = error.event
            step = max(step, event.step)  # the step that failed counts as taken, in a trial too
            self.state.optimiser.discard_gradients()
        except torch.OutOfMemoryError as error:
            raise Ended(Status.OUT_OF_MEMORY, self._too_many(step, error)) from error
        try:
            self.gaussians.update_filter_3d([view.camera for view in self.views])
        except InputError as error:
            event = event or NonFinite(step, "", "3D filter", error.found)
        status = Status.DIVERGED if event else Status.OK
        return FitOutcome(
            status=status,
            steps=step,
            message=str(event) if event else "",
            nonfinite=(event,) if event else (),
            stages=dict(self.stages),
            decisions=tuple(self.decisions),
        )

    def _prepare(self, steps: int, observer: Observer) -> None:
        """Make the depth prior, and add starting points on its surfaces if the options ask for them."""
        self._prior, count = self._depth_prior(steps, observer), self.options.prior.start_points
        if self._prior is not None and count > 0:
            self.state.start_from(with_surface_points(self._training_set, self._prior, count, self._seed))

    def _depth_prior(self, steps: int, observer: Observer) -> Prior | None:
        options = self.options
        if options.supervision.depth_weight <= 0 and options.prior.start_points <= 0:
            return None
        try:
            return make_prior(
                self._training_set,
                options.prior,
                seed=self._seed,
                steps=steps,
                device=self._device,
                progress=observer.stage,
            )
        except FloatingPointError as error:
            raise Place(0, "").error("depth prior", str(error)) from None

    def _all_photographs(self) -> dict[int, list[Photograph]]:
        options = self.options
        supervisor = self._prior if options.supervision.depth_weight > 0 else None
        held_back = max(options.reconstruction.held_back, HELD_BACK if self._trials.open else 0)
        return all_photographs(self.views, options.schedule.sizes, supervisor, held_back, self._seed, self._device)

    def _decide(self, step: int, progress: float, budget: Budget, observer: Observer) -> int:
        """Carry out the trials; returns the number of steps taken in all. A trial's steps are timed twice: as "trials"
        and by part of the step."""
        start = time.perf_counter()
        began, limit = observer.seconds(), math.inf if budget.seconds is None else MOST_TIME * budget.seconds
        total = round(step / progress)  # at the pace so far; by then a limited time may allow fewer than were planned
        step, self.decisions = self._trials.decide(
            step, total, progress, observer.stage, lambda: limit - (observer.seconds() - began)
        )
        self.stages["trials"] = time.perf_counter() - start
        self._photographs = self._all_photographs()
        return step

    def _too_many(self, step: int, error: torch.OutOfMemoryError) -> str:
        """One line about a device without enough memory."""
        count = len(self.gaussians)
        fitting = would_fit(count, self._device, error)
        return f"{count} Gaussians at step {step} are too many for {self._device}; try --set max_gaussians={fitting}"

    def _seen_loss(self, step: int) -> float:
        """The loss that the observer is told after this step."""
        assert self.state.loss is not None
        return self._seen.after(step, self.state.loss)

    def _next(self, step: int, progress: float) -> None:
        """Take the step after step number `step`, on the next photograph of the random order."""
        state = self.state
        index = state.order.next(progress, state.random)
        views = self._photographs[self.options.schedule.size(progress)]
        if views[0].camera.width != state.cameras[0].width:
            # The 3D filter depends on the sampling interval of the images that are trained on, which has just changed.
            state.cameras = [view.camera for view in views]
            update_filter(state, Place(step, views[index].name))
        state.loss = take_step(state, step + 1, progress, views[index], self._clock)
        # A masked pixel has no loss, which would make its view seem better explained than others.
        used = views[index].used
        state.order.record(index, state.loss / used if 0 < used < 1 else state.loss)

    def train(
        self,
        step: int,
        count: int,
        total: int,
        progress: float,
        tell: Callable[[int, int], None] = lambda done, of: None,
        left: Left = unlimited,
    ) -> bool:
        """Take `count` steps of a trial, after `step` of `total`, without telling the observer. tell: called with
        progress. False, after fewer steps, where at their pace `count` would take longer than what is left.

        Density control is postponed: for some steps after it has split Gaussians, single views are off by decibels,
        which would distort the trial's scores.
        """
        limit = left()
        if limit <= 0:
            return False
        with self.state.density.pace.rest():
            for taken in range(count):
                if taken >= _PACE and limit < math.inf and (limit - left()) / taken * count > limit:
                    return False
                tell(taken, count)
                self._next(step + taken, max(progress, (step + taken) / total))
        self.state.watch.look()
        return True

    def snapshot(self) -> Snapshot:
        """A copy of everything that training changes."""
        return self.state.snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        """Set everything that training changes to a snapshot, which stays usable."""
        self.state.restore(snapshot)

    def revise(self, changes: Mapping[str, Any]) -> None:
        """Change options; training continues with them."""
        self.state.revise(changes)

    def widest_circle(self) -> float:
        """Radius of the widest circles of confusion of the lenses learned so far, pixels
        (`blur_circles.widest_circle`)."""
        return widest_circle(self.gaussians, self.state.shots(), self.options.appearance)

    def foci_apart(self) -> float:
        """How far the lenses learned so far differ, pixels (`blur_circles.foci_apart`)."""
        return foci_apart(self.state.shots(), self.state.range)

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render at any camera; with a lens the image is defocused, without it is all in focus."""
        return render_view(self.gaussians, camera, self.options, lens=lens)

    def photograph(self, index: int) -> np.ndarray:
        """Training view number `index` rendered through its learned lens or blur and with its learned colour:
        (H, W, 3), encoded."""
        image = self._blurred(index)
        if image is None:
            lens = None if self.lenses is None else self._lens_estimate(index)
            image = torch.from_numpy(self.render(self.views[index].camera, lens).image).to(self._device)
        return self.colours.apply(index, image).numpy(force=True)

    @torch.no_grad()
    def _blurred(self, index: int) -> torch.Tensor | None:
        """(H, W, 3): training view number `index` through the learned blur that isn't a lens's; None without."""
        if self.state.blur is None:
            return None
        model, appearance = self.state.forward.at(1.0), self.options.appearance
        camera = self.views[index].camera
        sharp = SharpView(lambda: rasterise(self.gaussians, camera, appearance))
        shot = Shot(camera, self.state.range, 0.0, 0.0, number=index)
        return model.photograph(StillRasteriser(self.gaussians, appearance), sharp, shot)

    def held_back_scores(self, share: float | None = None) -> HeldBackScores:
        """Scores of the renderings of training photographs on held-back pixels. share: share of the tiles that trials
        hold back; the option `held_back` counts if it is larger."""
        photographs = {view.name: view.image for view in self.views}
        share = max(self.options.reconstruction.held_back, share or 0)
        masks = [view.mask for view in self.views]
        return held_back_scores(photographs, self.photograph, share, self._seed, masks)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The learned lens of each training view, in scene units."""
        if self.lenses is None:
            return None
        return {view.name: self._lens_estimate(index) for index, view in enumerate(self.views)}

    def colour_estimates(self) -> dict[str, np.ndarray] | None:
        """See `LearnedColours.estimates`."""
        return self.colours.estimates([view.name for view in self.views])

    @torch.no_grad()
    def _lens_estimate(self, index: int) -> PhysicalLens:
        camera, lenses = self.views[index].camera, self.lenses
        assert lenses is not None
        if lenses.follows_rendering:
            raster = rasterise(self.gaussians, camera, self.options.appearance)
            assert raster.depth is not None
            lenses.follow(index, surface_disparity(raster.depth, raster.alpha), raster.alpha)
        return lenses.estimate(index, camera.width)
