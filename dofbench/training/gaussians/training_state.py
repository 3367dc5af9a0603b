"""The state of a training of Gaussians: everything that training changes, and its snapshots."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.contracts import PointCloud, TrainingSet
from dofbench.core.lens import DisparityRange
from dofbench.runtime.raster import Geometry
from dofbench.training.common.depth import all_disparities
from dofbench.training.common.lens_profile import MeasuredLenses
from dofbench.training.common.lenses import LearnedLenses, first_lenses, lens_ties
from dofbench.training.common.losses import NO_ADAPTATION, AdaptationOptions
from dofbench.training.common.monitor import Watch
from dofbench.training.common.photograph_colours import LearnedColours
from dofbench.training.common.views import OrderState, ScaledView, ViewOrder
from dofbench.training.gaussians.forward_model import BlurStart, LearnedBlur, SharpView, Shot
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.lens_models import ForwardSchedule
from dofbench.training.gaussians.model import near_plane, scene_extent
from dofbench.training.gaussians.optimiser import GaussianOptimiser, ParameterState
from dofbench.training.gaussians.surface_terms import surface_terms


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A copy of a `TrainingState`."""

    options: GaussianOptions
    optimiser: dict[str, ParameterState]
    density: Any
    filter_3d: Tensor
    lenses: LearnedLenses | None
    order: OrderState
    random: np.random.Generator
    generator: Tensor
    loss: Tensor | None
    colours: LearnedColours
    blur: LearnedBlur | None


class TrainingState:
    """Gaussians, learned lenses, colours and blur, their optimisers, and the random generators, on one device.

    random: draws the order of views and rotates the aperture samples. generator: draws the children of Gaussians.
    cameras: of the views at the current training size. range: of the sparse points' disparities. loss: of the last
    step, None before the first. watch: finds values on a device that aren't finite.
    """

    def __init__(self, training_set: TrainingSet, options: GaussianOptions, seed: int, device: str = "cpu"):
        self._views, self._device = training_set.views, device
        self.cameras = [view.camera for view in self._views]
        self.gaussians = options.first_gaussians(training_set.points, device)
        self._extent = scene_extent(self.cameras)
        self.generator = torch.Generator().manual_seed(seed)
        self.random = np.random.default_rng(seed)
        assert training_set.points is not None  # `Gaussians.from_points` refuses a training set without
        self.range = DisparityRange.of_disparity(all_disparities(training_set.points, self.cameras))
        self.gaussians.near = near_plane(self.range, options.appearance.near_share)
        self.lenses: LearnedLenses | None = None
        if options.lens.lens:
            self.lenses = first_lenses(self._views, self.range, options.lens, device)
        self.colours = LearnedColours(len(self._views), options.colours, device)
        self.order = ViewOrder(len(self._views), options.outliers)
        generator = torch.Generator().manual_seed(seed)
        self.blur = options.learned_blur(BlurStart(self.gaussians, self.cameras, self._extent, generator))
        self.loss: Tensor | None = None
        self.watch = Watch()
        self._use(options)
        self._make_optimiser()
        self.gaussians.update_filter_3d(self.cameras)

    def _use(self, options: GaussianOptions) -> None:
        self.options = options
        self.forward = options.forward_models() if self.blur is None else ForwardSchedule(self.blur.models())
        self.terms = surface_terms(options.supervision, options.normals, options.distortion, self.range.extent)

    def _make_optimiser(self) -> None:
        options = self.options
        self.optimiser = GaussianOptimiser(self.gaussians, options.rates, self._extent)
        self.density = options.density_control(self.gaussians, self.optimiser, self._extent, self.generator)
        self.density.cameras = [view.camera for view in self._views]
        self.density.nearest = 1 / self.range.q_max

    def start_from(self, points: PointCloud) -> None:
        """Start again from these points. The object `gaussians` stays the same, since other objects refer to it."""
        self.gaussians.parameters = self.options.first_gaussians(points, self._device).parameters
        self._make_optimiser()
        self.gaussians.update_filter_3d(self.cameras)

    def learned(self) -> Mapping[str, LearnedLenses | LearnedColours | LearnedBlur]:
        """Quantities learned for the views besides the scene, by name."""
        found = {"lens": self.lenses, "blur": self.blur, "colours": self.colours}
        return {name: one for name, one in found.items() if one is not None}

    def adaptation(self, progress: float) -> AdaptationOptions:
        """The defocus-to-focus adaptation at `progress`, 0 to 1; none for a training without lenses."""
        return NO_ADAPTATION if self.lenses is None else self.options.adaptation.at(progress)

    def reads(self, adaptation: AdaptationOptions) -> Geometry:
        """The geometry that the learned lens and the adaptation need of a sharp view."""
        follows = self.lenses is not None and self.lenses.follows_rendering
        return "depth" if follows or adaptation.active else "none"

    def shot(self, view: ScaledView, sharp: SharpView, adaptation: AdaptationOptions) -> Shot:
        """Camera and lens of a view in one step; the aperture is 0 in a training without lenses."""
        if self.lenses is None:
            return Shot(view.camera, self.range, 0.0, 0.0, number=view.index)
        if self.lenses.follows_rendering:
            self.lenses.follow(view.index, sharp.disparity, sharp.raster.alpha)
        narrowed = adaptation.psi if adaptation.adaptation_aperture else None
        slope, offset = self.lenses.forward(view.index)
        clipped = self.options.lens.lens_clip
        return Shot(view.camera, self.lenses.ranges[view.index], slope, offset, narrowed, clipped, view.index)

    def shots(self) -> Sequence[Shot]:
        """All views with their lenses as learned so far, as numbers."""
        lenses, shots = self.lenses, []
        assert lenses is not None
        for index, camera in enumerate(self.cameras):
            aperture, focus = lenses.aperture_and_focus(index)
            clipped = self.options.lens.lens_clip
            shots.append(Shot(camera, lenses.ranges[index], aperture, -aperture * focus, clipped=clipped))
        return shots

    def revise(self, changes: Mapping[str, Any]) -> None:
        """Change options: disable the lens, let views share one, or use another forward model."""
        before = self.options.lens
        self._use(self.options.with_overrides(changes))
        if not self.options.lens.lens:
            self.lenses = None
        elif self.options.lens.lens_per != before.lens_per:
            assert self.lenses is not None
            self.lenses = self.lenses.shared(lens_ties(self._views, self.options.lens.lens_per))
        if self.lenses is not None:
            self.lenses.use(self.options.lens)

    def set_lenses(self, found: MeasuredLenses) -> None:
        """Set the lenses to measured ones, which share what the measurement says."""
        assert self.lenses is not None
        if not found.each and self.options.lens.lens_per == "view":
            self._use(self.options.with_overrides({"lens_per": "aperture"}))
        ties = lens_ties(self._views, self.options.lens.lens_per)
        errors = np.stack([found.aperture_error, found.focus_error], axis=1)
        self.lenses = self.lenses.measured(found.aperture, found.foci, errors, ties)

    def snapshot(self) -> Snapshot:
        """Copy the whole state."""
        assert self.gaussians.filter_3d is not None
        return Snapshot(
            options=self.options,
            optimiser=self.optimiser.state(),
            density=self.density.state(),
            filter_3d=self.gaussians.filter_3d.clone(),
            lenses=copy.deepcopy(self.lenses),
            order=self.order.state(),
            random=copy.deepcopy(self.random),
            generator=self.generator.get_state(),
            loss=self.loss,
            colours=copy.deepcopy(self.colours),
            blur=copy.deepcopy(self.blur),
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Set the state to a snapshot, which stays usable."""
        self.blur = copy.deepcopy(snapshot.blur)
        self._use(snapshot.options)
        self.optimiser.restore(snapshot.optimiser)
        self.density.restore(snapshot.density)
        self.gaussians.filter_3d = snapshot.filter_3d.clone()
        self.lenses = copy.deepcopy(snapshot.lenses)
        self.order.restore(snapshot.order)
        self.random = copy.deepcopy(snapshot.random)
        self.generator.set_state(snapshot.generator)
        self.loss, self.colours = snapshot.loss, copy.deepcopy(snapshot.colours)
