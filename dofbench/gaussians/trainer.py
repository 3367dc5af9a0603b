"""The training loop that every Gaussian method of this project shares."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.compute.raster import ViewStatistics
from dofbench.core.cameras import Camera
from dofbench.core.contracts import (
    Budget,
    Decision,
    FitOutcome,
    NonFinite,
    Observer,
    PointCloud,
    Rendering,
    TrainingSet,
)
from dofbench.core.errors import InputError, Status
from dofbench.core.lens import DisparityRange, PhysicalLens
from dofbench.gaussians import losses
from dofbench.gaussians.blur_circles import foci_apart, widest_circle
from dofbench.gaussians.density import DensityControl
from dofbench.gaussians.exposure import Shot, render_view, rings_for, sampled, scattered, summed
from dofbench.gaussians.lens_samples import together
from dofbench.gaussians.model import Gaussians, scene_extent
from dofbench.gaussians.optimiser import GaussianOptimiser
from dofbench.gaussians.render import SURFACE_ALPHA, rasterise, surface_disparity
from dofbench.gaussians.trials import HELD_BACK, Trials
from dofbench.gaussians.warmup import compile_kernels
from dofbench.learning.held_back import HeldBackScores, held_back_scores
from dofbench.learning.lens_ties import lens_ties
from dofbench.learning.lenses import LearnedLenses
from dofbench.learning.nonfinite import NonFiniteError, Place
from dofbench.learning.options import TrainerOptions
from dofbench.learning.outliers import OutlierViews
from dofbench.learning.photograph_colours import LearnedColours
from dofbench.learning.priors import Prior, make_prior, with_surface_points
from dofbench.learning.supervision import all_disparities
from dofbench.learning.training_views import Photograph, all_photographs

_RENDER_RANGE_QUANTILE = 0.95  # the released code's near end of the disparity range
_FILTER_3D_EVERY = 100  # steps; Mip-Splatting's interval


@dataclass(frozen=True, eq=False)
class Snapshot:
    """All that training changes, to come back to."""

    options: TrainerOptions
    optimiser: dict[str, dict[str, Tensor]]
    density: tuple[Tensor, Tensor, float]
    filter_3d: Tensor
    lenses: LearnedLenses | None
    order: list[int]
    random: np.random.Generator
    generator: Tensor
    loss: float
    colours: LearnedColours
    outliers: OutlierViews


class Trainer:
    """Trains Gaussians, and with `options.lens` a lens per view, on a training set.

    After `fit`, or during it from an observer, `render` and `lens_estimates` work at any time.
    """

    def __init__(self, training_set: TrainingSet, options: TrainerOptions, seed: int):
        self.options = options
        self.gaussians = Gaussians.from_points(training_set.points, options.sh_degree)
        self.views, self.count = training_set.views, len(training_set.views)
        self._training_set, self._seed = training_set, seed
        self._prior: Prior | None = None
        self._cameras = [view.camera for view in training_set.views]
        self._extent = scene_extent(self._cameras)
        self._generator = torch.Generator().manual_seed(seed)
        self._random = np.random.default_rng(seed)
        self.range = DisparityRange.of_disparity(all_disparities(training_set.points, self._cameras))
        self.lenses = None
        if options.lens:
            ties = lens_ties(self.views, options.lens_per)
            self.lenses = LearnedLenses(self.count, self.range, options, ties)
        self.colours = LearnedColours(self.count, options)
        self._outliers, self.left_out_views = OutlierViews(self.count), set()
        self._optimiser = GaussianOptimiser(self.gaussians, options, self._extent)
        self._density = DensityControl(self.gaussians, self._optimiser, options, self._extent, self._generator)
        self.stages: dict[str, float] = {}
        self._trials = Trials(self, options)
        self.decisions: list[Decision] = []
        self._photographs: dict[int, list[Photograph]] = {}
        self._order: list[int] = []
        self._loss = math.nan
        self._trying = self._put_off = False
        self.gaussians.update_filter_3d(self._cameras)

    def fit(self, budget: Budget, observer: Observer) -> FitOutcome:
        """Train until the budget or the observer ends it; a non-finite number, or nothing left to see, is diverged."""
        compile_kernels(self.gaussians, self._cameras[0], self.options)
        total = budget.steps or self.options.steps
        step, event = 0, None
        try:
            with self._timed("depth prior"):
                self._prior = self._depth_prior(total, observer)
                if self._prior is not None and self.options.start_points > 0:
                    self._start_from(
                        with_surface_points(self._training_set, self._prior, self.options.start_points, self._seed)
                    )
            self._photographs = self._all_photographs()
            while step < total:
                progress = step / total
                if budget.seconds is not None:
                    progress = max(progress, observer.seconds() / budget.seconds)
                    if progress >= 1:
                        break
                if self._trials.due(progress):
                    with self._timed("trials"):
                        step, self.decisions = self._trials.decide(step, total, progress, observer.stage)
                    self._photographs = self._all_photographs()
                else:
                    self._loss = self._next(step, progress)
                    step += 1
                if not observer.after_step(step, self._loss):
                    break
        except NonFiniteError as error:
            event = error.event
            step = max(step, event.step)  # the step that failed counts as taken, in a trial too
            self._optimiser.discard_gradients()
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

    def _next_round(self, progress: float) -> list[int]:
        """All views in random order, the next one last, without those that don't belong to the scene."""
        order = list(self._random.permutation(self.count))
        if self.options.outlier_views and progress >= self.options.outliers_from:
            self.left_out_views |= self._outliers.found()
            order = [index for index in order if index not in self.left_out_views]
        return order

    def _all_photographs(self) -> dict[int, list[Photograph]]:
        held_back = max(self.options.held_back, HELD_BACK if self._trials.open else 0)
        return all_photographs(self.views, self.options, self._prior, held_back, self._seed)

    def _next(self, step: int, progress: float) -> float:
        """The step after so many, on the next photograph in a random order; returns the loss."""
        if not self._order:
            self._order = self._next_round(progress)
        coarse = progress < self.options.coarse_until
        views = self._photographs[self.options.coarse_factor if coarse else 1]
        if views[0].camera.width != self._cameras[0].width:
            # The sampling interval of the 3D filter is that of the images trained on.
            self._cameras = [view.camera for view in views]
            self._update_filter(Place(step, views[self._order[-1]].name))
        index = self._order.pop()
        loss = self._step(step + 1, progress, views[index])
        self._outliers.record(index, loss)
        return loss

    def train(
        self,
        step: int,
        count: int,
        total: int,
        progress: float,
        tell: Callable[[int, int], None] = lambda done, of: None,
    ) -> None:
        """Take so many steps more, after `step` of `total`, which nobody observes: a trial's. tell: how many are taken.

        Density control is put off: for some steps after it has split Gaussians, single views are decibels off.
        """
        self._trying = True
        try:
            for taken in range(count):
                tell(taken, count)
                self._loss = self._next(step + taken, max(progress, (step + taken) / total))
        finally:
            self._trying = False

    def snapshot(self) -> Snapshot:
        """All that training changes, copied."""
        return Snapshot(
            options=self.options,
            optimiser=self._optimiser.state(),
            density=self._density.state(),
            filter_3d=self.gaussians.filter_3d.clone(),
            lenses=copy.deepcopy(self.lenses),
            order=list(self._order),
            random=copy.deepcopy(self._random),
            generator=self._generator.get_state(),
            loss=self._loss,
            colours=copy.deepcopy(self.colours),
            outliers=copy.deepcopy(self._outliers),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from there, as often as you like."""
        self.options = snapshot.options
        self._optimiser.restore(snapshot.optimiser)
        self._density.restore(snapshot.density)
        self.gaussians.filter_3d = snapshot.filter_3d.clone()
        self.lenses = copy.deepcopy(snapshot.lenses)
        self._order, self._random = list(snapshot.order), copy.deepcopy(snapshot.random)
        self._generator.set_state(snapshot.generator)
        self._loss = snapshot.loss
        self.colours, self._outliers = copy.deepcopy(snapshot.colours), copy.deepcopy(snapshot.outliers)

    def revise(self, changes: Mapping[str, Any]) -> None:
        """Go on with other options: without the lens, with one that photographs share, with another forward model."""
        before, self.options = self.options, self.options.with_overrides(changes)
        if not self.options.lens:
            self.lenses = None
        elif self.options.lens_per != before.lens_per:
            self.lenses = self.lenses.shared(lens_ties(self.views, self.options.lens_per))

    def widest_circle(self) -> float:
        """Of the lenses learned so far, pixels (`circles.widest_circle`)."""
        return widest_circle(self.gaussians, self._shots(), self.options)

    def foci_apart(self) -> float:
        """Of the lenses learned so far, pixels (`circles.foci_apart`)."""
        return foci_apart(self._shots(), self.range, self.options)

    def _start_from(self, points: PointCloud) -> None:
        """Begin anew from these points, in the same `gaussians`, which others hold too."""
        self.gaussians.parameters = Gaussians.from_points(points, self.options.sh_degree).parameters
        self._optimiser = GaussianOptimiser(self.gaussians, self.options, self._extent)
        self._density = DensityControl(self.gaussians, self._optimiser, self.options, self._extent, self._generator)
        self.gaussians.update_filter_3d(self._cameras)

    def _depth_prior(self, steps: int, observer: Observer) -> Prior | None:
        if self.options.depth_weight <= 0 and self.options.start_points <= 0:
            return None
        try:
            return make_prior(self._training_set, self.options, seed=self._seed, steps=steps, progress=observer.stage)
        except FloatingPointError as error:
            raise Place(0, "").error("depth prior", str(error)) from None

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.stages[stage] = self.stages.get(stage, 0.0) + time.perf_counter() - start

    def _step(self, step: int, progress: float, view: Photograph) -> float:
        """One optimisation step on one view; returns the loss."""
        options, place = self.options, Place(step, view.name)
        degree = min(options.sh_degree, int(progress / options.sh_every)) if options.sh_every > 0 else options.sh_degree
        with_normals = options.normal_weight > 0 and progress >= options.normal_from
        with_distortion = options.distortion_weight > 0 and progress >= options.distortion_from
        adapting = options.adaptation != "off" or options.adaptation_aperture
        adapting = adapting and self.lenses is not None and progress >= options.adaptation_from
        sampling = self.lenses is not None and options.lens_model == "samples" and progress >= options.lens_samples_from
        by_disparity = self.lenses is not None and (not sampling or adapting or options.lens_range == "render")
        rings = options.lens_rings if sampling and progress >= options.lens_rings_from else 0
        with_depth = by_disparity or view.known is not None or rings > 0

        with self._timed("rasterise"):
            statistics = ViewStatistics(want_abs=options.grow_absolute)
            geometry = "full" if with_normals else "depth" if with_depth else "none"
            geometry = "distortion" if with_distortion else geometry
            with place.located("rasterise"):
                raster = rasterise(
                    self.gaussians, view.camera, options, sh_degree=degree, geometry=geometry, statistics=statistics
                )
        # The graph is cut between the stages, so each stage's time and numbers can be looked at.
        colour = raster.color.detach().requires_grad_()
        alpha = raster.alpha.detach().requires_grad_(with_normals or with_distortion)
        depth = raster.depth.detach().requires_grad_() if raster.depth is not None else None
        outputs = [(raster.color, colour), (raster.alpha, alpha), (raster.depth, depth)]

        image, out_of_focus, seen = colour, None, [statistics]
        if self.lenses is not None:
            with self._timed("lens"):
                disparity = self._disparity(alpha, depth) if by_disparity else None
                lens = self._lens(view, alpha, disparity)
                out_of_focus = lens.out_of_focus(disparity) if adapting else None
                if not sampling:
                    with place.located("lens"):
                        image = scattered(colour, disparity, lens, options, adapting)
            if sampling:
                if rings > 0:  # no more than this photograph's circles need
                    rings = rings_for(lens.circles(depth, alpha, options), rings)
                samples, more = self._samples(place, lens, degree, rings, adapting)
                leaves = [sample.detach().requires_grad_() for sample in samples]
                outputs += zip(samples, leaves, strict=True)
                seen += more
                with self._timed("lens"):
                    image = together(leaves, options.lens_gamma)
            place.check(image, "lens")

        with self._timed("loss"):
            weight = losses.adaptation_weight(out_of_focus, options) if adapting else None
            image = self.colours.forward(view.index, image)
            image = losses.looked_at(image, view.image, view.held_back, options.clipped_white)
            loss = losses.reconstruction(image, view.image, options.ssim_weight, weight)
            if view.known is not None:
                supervision = losses.depth_loss(depth, alpha, view.known, options, self.range.extent, weight)
                if supervision is not None:
                    loss = loss + options.depth_factor(progress) * supervision
            if with_normals:
                normal = raster.normal.detach().requires_grad_()
                median = raster.median_depth.detach().requires_grad_(options.normal_median > 0)
                outputs += [(raster.normal, normal), (raster.median_depth, median)]
                loss = loss + options.normal_weight * losses.normal_consistency(
                    normal, alpha, depth, median, view.camera, options.normal_median, options.normal_form
                )
            if with_distortion:
                distortion = raster.distortion.detach().requires_grad_()
                outputs.append((raster.distortion, distortion))
                loss = loss + options.distortion_weight * losses.distortion_loss(
                    distortion, alpha, view.image, options.distortion_near, options.distortion_far
                )
        value = float(loss.detach())
        if not math.isfinite(value):
            raise place.error("loss", f"loss is {value}")

        with self._timed("loss and lens, backward"):
            loss.backward()
        reached = [(tensor, leaf.grad) for tensor, leaf in outputs if leaf is not None and leaf.grad is not None]
        for tensor_gradient in reached:
            place.check(tensor_gradient[1], "gradient by the rendering")
        with self._timed("rasterise, backward"):
            torch.autograd.backward([tensor for tensor, _ in reached], [gradient for _, gradient in reached])
        if self.lenses is not None:
            place.check(self.lenses.gradient(), "gradient by the lens")
        place.check(self.colours.gradient(), "gradient by the colours")
        for name, parameter in self.gaussians.parameters.items():
            if parameter.grad is not None:
                place.check(parameter.grad, f"gradient by {name}")

        with self._timed("optimiser"):
            self._optimiser.step(progress)
            if self.lenses is not None and progress >= options.lens_from:
                self.lenses.step(view.index, progress)
            self.colours.step(view.index, progress)
        with self._timed("density control"):
            statistics = summed([one for one in seen if one.grad_2d is not None])
            gradient_2d = statistics.abs_grad_2d if options.grow_absolute else statistics.grad_2d
            self._density.record(gradient_2d, statistics.visible, view.camera.width, view.camera.height)
            graded = self.gaussians.parameters["means"].detach()[:, 2] if options.prune_depth_graded else None
            if self._trying:
                changed, self._put_off = False, self._put_off or self._density.due(step)
            else:
                changed = self._density.after_step(step, progress, graded, overdue=self._put_off)
                self._put_off = False
            if changed or step % _FILTER_3D_EVERY == 0:
                self._update_filter(place)
        return value

    def _update_filter(self, place: Place) -> None:
        """The 3D filter anew. Gaussians that all faded, or fled, are training's failure and not the user's mistake."""
        try:
            self.gaussians.update_filter_3d(self._cameras)
        except InputError as error:
            raise place.error("density control", error.found) from None

    def _shots(self) -> list[Shot]:
        """All training views with their lenses as learned so far, as numbers."""
        shots = []
        for index, camera in enumerate(self._cameras):
            aperture, focus = self.lenses.aperture_and_focus(index)
            shots.append(Shot(camera, self.lenses.ranges[index], aperture, -aperture * focus))
        return shots

    def _samples(
        self, place: Place, lens: Shot, degree: int, rings: int, adapting: bool
    ) -> tuple[list[Tensor], list[ViewStatistics]]:
        """What the points of the lens see, and the statistics of each; the points turn at random."""
        with self._timed("rasterise"), place.located("rasterise"):
            rasters, statistics = sampled(
                self.gaussians,
                lens,
                self.options,
                rings,
                rotation=self._random.uniform(0, 2 * math.pi),
                sh_degree=degree,
                want_abs=self.options.grow_absolute,
                adapting=adapting,
            )
        return [raster.color for raster in rasters], statistics

    def _disparity(self, alpha: Tensor, depth: Tensor) -> Tensor:
        surface = depth if self.options.blur_to_depth else depth.detach()
        return surface_disparity(surface, alpha.detach())

    def _lens(self, view: Photograph, alpha: Tensor, disparity: Tensor | None) -> Shot:
        """The learned lens of a view, for one step."""
        if self.options.lens_range == "render":
            self.lenses.ranges[view.index] = _rendered_range(disparity, alpha, self.range)
        return Shot(view.camera, self.lenses.ranges[view.index], *self.lenses.forward(view.index))

    def render(self, camera: Camera, lens: PhysicalLens | None) -> Rendering:
        """Render at any camera; with a lens the image is defocused, without it is all in focus."""
        return render_view(self.gaussians, camera, self.options, lens=lens)

    def photograph(self, index: int) -> np.ndarray:
        """Training view number `index` as it was photographed, by its learned lens and colour: (H, W, 3), encoded."""
        lens = None if self.lenses is None else self._lens_estimate(index)
        image = self.render(self.views[index].camera, lens).image
        return self.colours.apply(index, torch.from_numpy(image)).numpy()

    def held_back_scores(self, share: float | None = None) -> HeldBackScores:
        """How well the training photographs are made again where training didn't look (option `held_back`, or the
        share that trials hold back)."""
        photographs = {view.name: view.image for view in self.views}
        share = max(self.options.held_back, share or 0)
        return held_back_scores(photographs, self.photograph, share, self._seed)

    def lens_estimates(self) -> dict[str, PhysicalLens] | None:
        """The learned lens of each training view, in scene units."""
        if self.lenses is None:
            return None
        return {view.name: self._lens_estimate(index) for index, view in enumerate(self.views)}

    def colour_estimates(self) -> dict[str, np.ndarray] | None:
        """The learned colour of each training view, (3, 4) as in `colours.py`."""
        if not self.colours.learned:
            return None
        return {view.name: self.colours.matrix(index) for index, view in enumerate(self.views)}

    @torch.no_grad()
    def _lens_estimate(self, index: int) -> PhysicalLens:
        camera = self.views[index].camera
        if self.options.lens_range == "render":
            raster = rasterise(self.gaussians, camera, self.options)
            disparity = surface_disparity(raster.depth, raster.alpha)
            self.lenses.ranges[index] = _rendered_range(disparity, raster.alpha, self.range)
        return self.lenses.estimate(index, camera.width)


def _rendered_range(disparity: Tensor, alpha: Tensor, fallback: DisparityRange) -> DisparityRange:
    """Minimum and 95th percentile over the pixels that have a surface, as the released code scales them."""
    known = disparity.detach()[alpha.detach() > SURFACE_ALPHA].numpy()
    if known.size == 0:
        return fallback
    low, high = float(known.min()), float(np.quantile(known, _RENDER_RANGE_QUANTILE))
    return DisparityRange(low, high) if high > low else fallback
