"""Short trainings, and checks for impossible outputs of the trained method."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dofbench.core.budget import Budget
from dofbench.core.contracts import FitOutcome, Method, TrainingSet
from dofbench.core.errors import Status
from dofbench.core.lens import Lens
from dofbench.evaluation.stability.training_scene import FAR, VIEWS, WIDTH, true_lens, true_range
from dofbench.methods.cards import MethodEntry
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.gaussians.gaussian_method import GaussianMethod
from dofbench.training.gaussians.gaussian_options import GaussianOptions

STEPS = 240
# A lens counts as found if its error is below this share of the constant prediction's, A = F = 0.5
FOUND = 0.5
ABSURD_LIGHT, ABSURD_DEPTH = 10.0, 1e3 * FAR
DENSIFY_EVERY = 25
# Schedules shortened to a hundred steps, without depth priors slower than the training.
SHORT = {
    "steps": STEPS,
    "depth_prior": "sparse",
    "start_points": 0,
    "sh_degree": 1,
    "densify_every": DENSIFY_EVERY,
    "max_gaussians": 800,
    "coarse_until": 0.0,
    "reset_every": 0.0,
    "scale_lr": 2e-2,
}
# For fields: fewer rays, and a grid as coarse as these views.
SHORT_FIELD = {"batch_pixels": 256, "grid_nodes": 64, "grid_nodes_first": 32}
SHORT_LENS = {"lens_lr": 0.2, "lens_lr_final": 0.025, "lens_init_aperture": 2.0}


class Watch:
    """An observer that records every loss and may change the training after a step."""

    def __init__(self, meddle: Callable[[int], None] | None = None):
        self.losses: list[float] = []
        self._meddle, self._start = meddle, time.perf_counter()

    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._start

    def after_step(self, step: int, loss: float) -> bool:
        """Record the loss, and continue training."""
        self.losses.append(loss)
        if self._meddle is not None:
            self._meddle(step)
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""


@dataclass(frozen=True)
class End:
    """How a run ended. wrong: an impossible output of a run with status ok, or a missing status."""

    status: str
    wrong: str = ""
    found: bool = False
    losses: tuple[float, ...] = field(default=(), repr=False)

    @property
    def better(self) -> bool:
        """Whether the loss fell to three quarters of its initial value, both averaged over an epoch."""
        epoch = min(VIEWS, max(1, len(self.losses) // 4))
        return bool(self.losses) and np.mean(self.losses[-epoch:]) < 0.75 * np.mean(self.losses[:epoch])


def options_of(entry: MethodEntry, **changes: Any) -> dict[str, Any]:
    """The method's preset `cpu`, or else its default, shortened, with changes; unchanged for another trainer."""
    _, options, _ = entry.preset("cpu" if "cpu" in entry.card.presets else None)
    made = entry.create({}, 0, "cpu")
    if isinstance(made, FieldMethod):
        return {**options, **SHORT_FIELD}
    if not isinstance(made, GaussianMethod):
        return options
    short = {**SHORT, **(SHORT_LENS if entry.card.capabilities.learns_lens else {})}
    return {key: value for key, value in {**options, **short, **changes}.items() if key not in made.FORCED}


def faster(entry: MethodEntry, names: tuple[str, ...], factor: float) -> dict[str, Any]:
    """The named learning rates, times a factor."""
    usual = {**GaussianOptions().flat(), **options_of(entry)}
    return {name: usual[name] * factor for name in names}


def run(
    entry: MethodEntry, training_set: TrainingSet, seed: int = 0, *, one_plane: bool = False, **changes: Any
) -> End:
    """Train for `STEPS` steps, then check all outputs of the method."""
    method = entry.create(options_of(entry, **changes), seed, "cpu")
    watch = Watch()
    try:
        outcome = method.fit(training_set, Budget(steps=STEPS), watch)
    except Exception as error:  # `dofbench run` would have to turn such an exception into a status itself
        return End("no status", _text(error), losses=tuple(watch.losses))
    if outcome.status is not Status.OK:
        return End(outcome.status, _unexplained(outcome), losses=tuple(watch.losses))
    try:
        with np.errstate(all="ignore"):
            wrong = _absurd(method, training_set, watch.losses)
    except Exception as error:
        wrong = f"after training: {_text(error)}"[:100]
    return End("ok", wrong, not wrong and lens_found(method, one_plane), tuple(watch.losses))


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:100]


def _unexplained(outcome: FitOutcome) -> str:
    if outcome.status is Status.DIVERGED and not any(event.step == outcome.steps for event in outcome.nonfinite):
        return "diverged, without saying at which step"
    return ""


def _absurd(method: Method, training_set: TrainingSet, losses: list[float]) -> str:
    if not np.isfinite(losses).all():
        return "a loss that isn't finite"
    lenses = method.lens_estimates()
    for view in training_set.views:
        lens = None if lenses is None else lenses[view.name]
        for shown in [None] if lens is None else [None, lens]:
            if lens is not None and not (math.isfinite(lens.aperture) and math.isfinite(lens.focus_disparity)):
                return f"lens of {view.name}: {lens.aperture:.3g}, {lens.focus_disparity:.3g}"
            rendering = method.render(view.camera, shown)
            light, depth = float(np.abs(rendering.image).mean()), rendering.depth
            if not np.isfinite(rendering.image).all() or light > ABSURD_LIGHT:
                return f"render of {view.name}: light of {light:.3g} times white"
            if not np.isfinite(depth).all() or depth.min() < 0 or depth.max() > ABSURD_DEPTH:
                return f"depth of {view.name}: {depth.min():.3g} to {depth.max():.3g}"
        if lens is not None:
            least = min(abs(float(lens.signed_radius(q, WIDTH))) for q in (true_range().q_min, true_range().q_max))
            if least > WIDTH:
                return f"lens of {view.name}: nothing blurred by less than {least:.3g} pixels"
    return ""


def lens_found(method: Method, one_plane: bool) -> bool:
    """Whether the learned lenses' error in CoC radius is below half of that of a constant prediction."""
    lenses = method.lens_estimates()
    if lenses is None:
        return False
    disparities = np.linspace(true_range().q_min, true_range().q_max, 5)
    nothing = np.abs(Lens(0.5, 0.5).physical(true_range(), WIDTH).signed_radius(disparities, WIDTH))
    errors, unlearned = [], []
    for index, lens in enumerate(lenses.values()):
        true = np.abs(true_lens(index, one_plane).physical(true_range(), WIDTH).signed_radius(disparities, WIDTH))
        errors.append(np.abs(np.abs(lens.signed_radius(disparities, WIDTH)) - true).mean())
        unlearned.append(np.abs(nothing - true).mean())
    return float(np.mean(errors)) < FOUND * float(np.mean(unlearned))
