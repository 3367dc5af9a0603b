"""The training loop of all Gaussian methods."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import LENS_MEASURED, Decision, FitOutcome, NonFinite, Observer, Rendering, TrainingSet
from dofbench.core.errors import Ended, InputError, Status
from dofbench.core.lens import PhysicalLens
from dofbench.runtime.device_memory import would_fit
from dofbench.training.common.depth import surface_disparity
from dofbench.training.common.held_out import HeldOutScores, held_out_scores
from dofbench.training.common.lenses import LearnedLenses
from dofbench.training.common.monitor import NonFiniteError, Place, ReportedLoss, StageClock
from dofbench.training.common.pace import Pace
from dofbench.training.common.photograph_colours import LearnedColours
from dofbench.training.common.priors import Prior, make_prior, with_points_behind, with_surface_points
from dofbench.training.common.reproduction import Reproduction, reproduction
from dofbench.training.common.views import ScaledViews
from dofbench.training.gaussians.early_stopping import Best, EarlyStopping
from dofbench.training.gaussians.forward_model import SharpView, Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_renderer import LensRenderer, StillRasteriser, foci_apart, widest_circle
from dofbench.training.gaussians.lens_start import measured_lenses
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.training_state import Snapshot, TrainingState
from dofbench.training.gaussians.training_step import take_step, update_filter
from dofbench.training.gaussians.trials import HELD_BACK, MOST_TIME, Left, Trials, possible_models, unlimited
from dofbench.training.gaussians.warmup import compile_kernels

_PACE = 3  # steps of a trial from which the time of the rest is estimated


@dataclass(frozen=True, eq=False)
class TrainerState:
    """All that a training needs to go on in another process, after `step`; `Trainer` says what the entries are."""

    step: int
    snapshot: Snapshot
    cameras: list[Camera]
    left_out: set[int]
    overdue: bool
    pace: dict[str, Any]
    seconds: dict[str, float]
    decisions: list[Decision]
    questions: tuple[str, ...]
    stopping: EarlyStopping
    unmeasured: bool


class Trainer:
    """Trains Gaussians, and with the option `lens` a lens per view, on a training set.

    After `fit`, or during it from an observer, `render` and `lens_estimates` work at any time. gaussians: always the
    same object. prior: of the depth, None before `fit` or without.
    """

    def __init__(self, training_set: TrainingSet, options: GaussianOptions, seed: int, device: str = "cpu"):
        self.state = TrainingState(training_set, options, seed, device)
        self.views, self.gaussians = training_set.views, self.state.gaussians
        self.decisions: list[Decision] = []
        self._training_set, self._seed, self._device = training_set, seed, device
        self._reported = ReportedLoss(self.state.watch)
        self._clock = StageClock()
        self._trials = Trials(self, options)
        # A reset of the opacities sets the scores back for a while, which isn't overfitting.
        begins = options.density.densify_until if options.density.reset_every > 0 else 0.0
        self._stopping = EarlyStopping(options.stopping, options.schedule.cooldown_from, len(self.views), begins)
        self._unmeasured = options.lens.lens and options.lens.lens_measured_at < 1
        self.prior: Prior | None = None
        self._scaled: dict[int, ScaledViews] = {}  # by the factor by which they are shrunk
        self._step = 0
        self._pace: Pace | None = None  # of the training that is going on
        self._kept: TrainerState | None = None  # of an earlier process, to go on from

    @property
    def options(self) -> GaussianOptions:
        """The current options, which trials may have revised."""
        return self.state.options

    @property
    def lenses(self) -> LearnedLenses | None:
        """The lenses as learned so far; None for a training without lenses."""
        return self.state.lenses

    @property
    def colours(self) -> LearnedColours:
        """The colour corrections as learned so far."""
        return self.state.colours

    @property
    def left_out_views(self) -> set[int]:
        """Numbers of the views excluded as outliers (option `outlier_views`)."""
        return self.state.order.left_out

    @property
    def stages(self) -> dict[str, float]:
        """Seconds by part of the training."""
        return self._clock.seconds

    def fit(self, budget: Budget, observer: Observer) -> FitOutcome:
        """Train until the budget or the observer ends it.

        A non-finite value, or no Gaussian left in front of the cameras, ends with the status "diverged". Raises Ended,
        which says how many Gaussians would fit, when a device is out of memory.
        """
        geometries = [term.reads for term in self.state.terms]
        models = (*possible_models(self.options), *self.state.forward.models)
        samples_aperture = any(model.samples_aperture for model in models)
        more = () if self.state.blur is None else self.state.blur.kernels
        compile_kernels(self.gaussians, self.state.cameras[0], self.options, geometries, samples_aperture, more)
        preset = self.options.schedule.steps
        pace = self._pace = Pace(budget, preset, observer.seconds)
        event, probe = None, partial(self._time_of_a_step, observer)
        try:
            if self._kept is None:
                with self._clock.timed("depth prior"):
                    self._prepare(budget.steps or preset, observer)
                self._scaled = self._scale_views()
                pace.plan(self.options.starts(), probe)
            else:
                self._resume(self._kept)
                pace.restore(self._kept.pace, probe)
            while (progress := pace.progress(self._step)) < 1:
                self._forget_sizes(progress)
                if self._trials.due(self._step, progress):
                    self._step = self._decide(self._step, progress, budget, observer)
                    pace.resume(self._step)
                    pace.plan(self.options.starts(), probe)
                else:
                    if self._unmeasured and progress >= self.options.lens.lens_measured_at:
                        self._unmeasured = False
                        if self.lenses is not None:
                            self._measure(observer)
                    self._next(self._step, progress)
                    self._step += 1
                if self._stopping.active:
                    self._stop_early(self._step, pace)
                assert self.state.loss is not None
                if not observer.after_step(self._step, self._reported.after(self._step, self.state.loss)):
                    break
            self.state.watch.look()
            if self._stopping.active:
                self._keep_best(self._step)
        except NonFiniteError as error:
            event = error.event
            self._step = max(self._step, event.step)  # the step that failed counts as taken, in a trial too
            self.state.optimiser.discard_gradients()
        except torch.OutOfMemoryError as error:
            raise Ended(Status.OUT_OF_MEMORY, self._too_many(self._step, error)) from error
        try:
            self.gaussians.update_filter_3d([view.camera for view in self.views])
        except InputError as error:
            event = event or NonFinite(self._step, "", "3D filter", error.found)
        return FitOutcome(
            status=Status.DIVERGED if event else Status.OK,
            steps=self._step,
            message=str(event) if event else "",
            nonfinite=(event,) if event else (),
            stages=dict(self.stages),
            decisions=tuple(self.decisions),
        )

    def training_state(self) -> TrainerState:
        """Everything that training has changed so far, to be asked for by an observer of a step, and to be pickled."""
        state, pace = self.state, self._pace
        assert pace is not None
        state.watch.look()
        return TrainerState(
            self._step,
            self.snapshot(),
            state.cameras,
            state.order.left_out,
            state.density.pace.overdue,
            pace.state(),
            self._clock.seconds,
            self.decisions,
            self._trials.open_questions,
            self._stopping,
            self._unmeasured,
        )

    def resume_from(self, kept: TrainerState, prior: Prior | None) -> None:
        """Let `fit` go on from the state of an earlier process and its depth prior, on a CPU to the same bits."""
        self._kept, self.prior = kept, prior

    def _resume(self, kept: TrainerState) -> None:
        self._step = kept.step
        self.restore(kept.snapshot)
        self.state.cameras, self.state.order.left_out = kept.cameras, kept.left_out
        self.state.density.pace.overdue = kept.overdue
        self._clock.seconds, self.decisions = kept.seconds, kept.decisions
        self._trials.open_questions, self._stopping, self._unmeasured = kept.questions, kept.stopping, kept.unmeasured
        self._scaled = self._scale_views()

    def _prepare(self, steps: int, observer: Observer) -> None:
        """Make the depth prior, and add starting points on its surfaces if the options ask for them."""
        options, count = self.options, self.options.prior.start_points
        if options.supervision.depth_weight > 0 or count > 0:
            try:
                self.prior = make_prior(
                    self._training_set,
                    options.prior,
                    seed=self._seed,
                    steps=steps,
                    device=self._device,
                    progress=observer.stage,
                )
            except FloatingPointError as error:
                raise Place(0, "").error("depth prior", str(error)) from None
        if self.prior is not None and count > 0:
            points = with_surface_points(self._training_set, self.prior, count, self._seed)
            behind = round(options.prior.start_behind * count)
            if behind > 0:
                points = with_points_behind(self._training_set, points, self.prior, behind, self._seed)
            self.state.start_from(points)
        if options.supervision.depth_weight == 0:
            self.prior = None  # has no further use

    def _scale_views(self, progress: float = 0.0) -> dict[int, ScaledViews]:
        """The views at the sizes that training uses from `progress` on."""
        return {factor: self._scaled_by(factor) for factor in self.options.schedule.sizes_from(progress)}

    def _scaled_by(self, factor: int) -> ScaledViews:
        options = self.options
        supervisor = self.prior if options.supervision.depth_weight > 0 else None
        held_back = max(options.reconstruction.held_back, HELD_BACK if self._trials.open else 0)
        return ScaledViews(self.views, factor, supervisor, held_back, self._seed, self._device)

    def _forget_sizes(self, progress: float) -> None:
        """Free the views at sizes that are over at `progress`."""
        for factor in self._scaled.keys() - set(self.options.schedule.sizes_from(progress)):
            del self._scaled[factor]

    def _decide(self, step: int, progress: float, budget: Budget, observer: Observer) -> int:
        """Run the trials; returns the number of steps taken in all. Timed as "trials" and by part of a step."""
        start = time.perf_counter()
        began, limit = observer.seconds(), math.inf if budget.seconds is None else MOST_TIME * budget.seconds
        total = round(step / progress)  # at the pace so far; by then a limited time may allow fewer than were planned
        step, decisions = self._trials.decide(
            step, total, progress, observer.stage, lambda: limit - (observer.seconds() - began)
        )
        self.decisions += decisions
        self.stages["trials"] = time.perf_counter() - start
        self._scaled.clear()  # before others take their place
        self._scaled = self._scale_views(progress)
        return step

    def _measure(self, observer: Observer) -> None:
        """Measure the lenses on the scene so far, and go on from them if they are determined."""
        observer.stage("lens measured", 0, 1)
        with self._clock.timed("lens measured"):
            found = measured_lenses(self.gaussians, self.state, self.views, self.options, self._seed)
        observer.stage("lens measured", 1, 1)
        reason = "too few patches that two photographs show" if found is None else str(found)
        determined = found is not None and found.determined
        self.decisions.append(Decision(LENS_MEASURED, determined, reason))
        if found is not None and determined:
            self.state.set_lenses(found)
            self._trials.settle("share")

    def _stop_early(self, step: int, pace: Pace) -> None:
        """Score the state after `step` if it is due. If training is to stop, return to the best state, for the cooldown
        or the end."""
        stopping, progress = self._stopping, pace.progress(step)
        # Before the trials options may still change.
        if self._trials.open or not stopping.due(step, progress):
            return
        self.state.watch.look()
        with self._clock.timed("held-out score"):
            stopping.scored(step, progress, self.held_out_scores().ssim, self.snapshot)
        if stopping.stopped is not None and stopping.best is not None:
            self.restore(stopping.best.state)
            pace.end(self.options.schedule.cooldown_from, step, stopping.cooldown_steps())

    def _keep_best(self, step: int) -> None:
        """Score the last state, and return to the best one if that is another."""
        best = self._stopping.best
        with self._clock.timed("held-out score"):
            last = Best(step, self.held_out_scores().ssim, None)
        if best is not None and not last.ssim > best.ssim:
            self.restore(best.state)
            last = best
        self.decisions.append(self._stopping.decision(last, step))

    def _too_many(self, step: int, error: torch.OutOfMemoryError) -> str:
        count = len(self.gaussians)
        fitting = would_fit(count, self._device, error)
        return f"{count} Gaussians at step {step} are too many for {self._device}; try --set max_gaussians={fitting}"

    def _time_of_a_step(self, observer: Observer, progress: float) -> float:
        """Seconds of a step at `progress`, which is undone."""
        snapshot, cameras, loss = self.state.snapshot(), self.state.cameras, self.state.loss
        with self.state.density.pace.rest():
            start = observer.seconds()
            self._next(0, progress)
            assert self.state.loss is not None
            float(self.state.loss)  # waits for a device
            took = observer.seconds() - start
        self.state.restore(snapshot)
        self.state.cameras, self.state.loss = cameras, loss
        return took

    def _next(self, step: int, progress: float) -> None:
        """Take the step after step number `step`, on the next view of the random order."""
        state = self.state
        index = state.order.next(progress, state.random)
        factor = self.options.schedule.size(progress)
        views = self._scaled.get(factor) or self._scaled.setdefault(factor, self._scaled_by(factor))
        if views.cameras[0].width != state.cameras[0].width:
            # The 3D filter depends on the sampling interval of the training size, which has just changed.
            state.cameras = views.cameras
            update_filter(state, Place(step, self.views[index].name))
        view = views[index]
        state.loss = take_step(state, step + 1, progress, view, self._clock)
        # A masked pixel has no loss, which would make its view seem better explained than others.
        used = view.used
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
        """Take `count` steps of a trial after `step` of `total`, without the observer; see `Trainee.train`.

        Density control is postponed: for some steps after a split, single views are off by decibels, which would
        distort the trial's scores.
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
        return self.state.snapshot()

    def restore(self, snapshot: Snapshot) -> None:
        self.state.restore(snapshot)

    def revise(self, changes: Mapping[str, Any]) -> None:
        self.state.revise(changes)

    def widest_circle(self) -> float:
        return widest_circle(self.gaussians, self.state.shots(), self.options.appearance)

    def foci_apart(self) -> float:
        return foci_apart(self.state.shots(), self.state.range)

    def reproduction(self) -> Reproduction:
        return reproduction(self.views, self.render_view)

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render at any camera: through a lens, or all in focus."""
        return LensRenderer(self.gaussians, self.options).render(camera, lens)

    def render_view(self, index: int) -> np.ndarray:
        """(H, W, 3), encoded: render training view number `index` with its learned lens or blur, and colour."""
        image = self._render_blurred(index)
        if image is None:
            lens = None if self.lenses is None else self._lens_estimate(index)
            image = torch.from_numpy(self.render(self.views[index].camera, lens).image).to(self._device)
        return self.colours.apply(index, image).numpy(force=True)

    @torch.no_grad()
    def _render_blurred(self, index: int) -> torch.Tensor | None:
        """(H, W, 3): render a training view with its learned blur that isn't a lens's; None without."""
        if self.state.blur is None:
            return None
        model, appearance = self.state.forward.at(1.0), self.options.appearance
        camera = self.views[index].camera
        sharp = SharpView(lambda: rasterise(self.gaussians, camera, appearance))
        shot = Shot(camera, self.state.range, 0.0, 0.0, number=index)
        return model.render(StillRasteriser(self.gaussians, appearance), sharp, shot)

    def held_out_scores(self, share: float | None = None) -> HeldOutScores:
        """Score the training views on held-out pixels. share: of the tiles; the option `held_back` if it is larger."""
        images = ((view.name, view.image) for view in self.views)
        share = max(self.options.reconstruction.held_back, share or 0)
        masks = [view.mask for view in self.views]
        return held_out_scores(images, self.render_view, share, self._seed, masks)

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
