"""Trials while training: which of two settings explains the photographs better.

Whether there is a lens, whether photographs share it, and which forward model is right can't be decided from sparse
points, because structure from motion finds points where a photograph is sharp. So training continues for some steps
with each of two settings, from the same state and on the same photographs in the same order, and both are scored on
tiles of the training photographs that no loss has used (`held_back.py`). Differences are paired by view. The state of
the better setting is kept, so only the steps of the other one are lost. Afterwards the tiles are used in training like
all others.

Where training is limited in time, trials get a share of it. A trial that would not end within what is left of that
share is given up, and its question stays undecided: training keeps the setting that it began with.

Figures of a decision: "NAME gain", by how many dB the setting NAME explains held-back pixels better than the setting
that it was compared with, and "NAME error", the standard error of the gain; "circle", `Trainee.widest_circle`, and
"apart", `Trainee.foci_apart`, both in pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from dofbench.core.contracts import Decision, TrainingView
from dofbench.core.time_left import Progress, silent
from dofbench.training.common.held_back import HeldBackScores
from dofbench.training.gaussians.forward.forward_model import ForwardModel
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.trial_options import QUESTIONS

HELD_BACK = 0.08  # share of the tiles
VISITS = 2  # smallest number of visits of each photograph in a trial
MOST = 0.06  # largest share of the training's steps that a trial may take
LONGEST = 200  # steps of a trial, unless its visits need more: longer ones decide alike (docs/notes/lens.md)
MOST_TIME = 0.35  # largest share of a limited training time that all trials may take
NO_CIRCLE = 0.3  # px, radius: smaller circles of confusion are invisible in a photograph
SMALL_CIRCLE = 1.0  # px, radius: with smaller circles a lens is kept only if it explains held-back pixels better
EXPLAINED = 0.01  # dB on held-back pixels: a smaller gain is noise (docs/notes/lens.md)
WORTH = 0.05  # dB on held-back pixels: with a smaller difference the simpler setting counts as equally good
SURE = 2.0  # standard errors by which held-back pixels must be better with a lens, or worse for leaving it out
# Standard errors by which the forward model that costs more must be better. Whatever a lens took has occlusion, so less
# is asked than of a lens: photographs of widely differing circles of confusion differ widely in their gains.
LIKELY = 1.0
FOCI_APART = 1.0  # px: photographs in which a point's circles differ by more can't share a focus


Left = Callable[[], float]  # how many seconds of a limited time are left


def unlimited() -> float:
    """Time without a limit."""
    return math.inf


class Trainee(Protocol):
    """A training on which trials can be made. A snapshot holds everything that training changes; its type is up to the
    trainee."""

    @property
    def views(self) -> Sequence[TrainingView]:
        """What it is trained on."""

    def snapshot(self) -> Any:
        """A copy of everything that training changes."""

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot, which stays usable."""

    def revise(self, changes: Mapping[str, Any]) -> None:
        """Change options; training continues with them."""

    def train(
        self, step: int, count: int, total: int, progress: float, tell: Callable[[int, int], None], left: Left
    ) -> bool:
        """Take `count` steps after `step` of `total`, at `progress` or later. tell: called with the number of steps
        taken and `count`. False, after fewer steps, where `count` would take longer than what is left."""

    def held_back_scores(self, share: float) -> HeldBackScores:
        """Scores of the renderings of the training photographs on their held-back tiles. share: share of the tiles."""

    def widest_circle(self) -> float:
        """Radius of the widest circles of confusion of the lenses learned so far, pixels
        (`blur_circles.widest_circle`)."""

    def foci_apart(self) -> float:
        """How far the lenses learned so far differ, pixels (`blur_circles.foci_apart`)."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A finished trial. changes: options that it changed. end: snapshot at its end. psnr: of each view's held-back
    tiles, dB."""

    changes: Mapping[str, Any]
    end: Any
    psnr: np.ndarray


_Try = Callable[[Mapping[str, Any], str], _Attempt | None]  # by what it changes, and what to call it; None: no time
_NO_TIME = "not decided: the training time that is left doesn't allow a trial of"


class Trials:
    """Decides the questions of the option lens_trials by trials, once in a training."""

    def __init__(self, trainee: Trainee, options: GaussianOptions):
        self._trainee = trainee
        self._open = questions(options) if options.lens.lens else ()
        self._at, self._share = options.trials.lens_trials_at, options.trials.lens_trials_steps

    @property
    def open(self) -> bool:
        """Whether the trials are still to come."""
        return bool(self._open)

    def due(self, step: int, progress: float) -> bool:
        """Whether the trials are to take place after `step`: when it is time, but not before every photograph has been
        seen, since a training of a few seconds may have taken hardly a step by then."""
        return self.open and progress >= self._at and step >= len(self._trainee.views)

    def length(self, total: int, views: int) -> int:
        """Steps of one trial, in a training of `total` steps on so many views."""
        enough = min(round(self._share * total), LONGEST)
        return max(1, min(max(enough, VISITS * views), round(MOST * total)))

    def decide(
        self, step: int, total: int, progress: float, tell: Progress = silent, left: Left = unlimited
    ) -> tuple[int, list[Decision]]:
        """Carry out the trials and leave the trainee in the state of the best one; returns the number of steps taken in
        all, and the decisions.

        total: as far as is known, where time is limited. tell: called with the name of a trial, the steps taken, and
        its length. left: tells how many seconds all trials may still take.
        """
        trainee, questions_open = self._trainee, self._open
        self._open = ()
        steps = min(self.length(total, len(trainee.views)), total - step)
        start = trainee.snapshot()

        def attempt(changes: Mapping[str, Any], words: str, left: Left = left) -> _Attempt | None:
            trainee.restore(start)
            trainee.revise(changes)
            if not trainee.train(step, steps, total, progress, partial(tell, f"trying {words}"), left):
                return None
            views = trainee.held_back_scores(HELD_BACK).views
            return _Attempt(changes, trainee.snapshot(), np.array([psnr for psnr, _ in views.values()]))

        # The first trial is no detour, since training goes on as it was: it has all the time that it takes.
        best, decisions = attempt({}, "what was learned so far", unlimited), []
        assert best is not None
        if "lens" in questions_open:
            best, decided = self._lens(attempt, best)
            decisions.append(decided)
        if "lens" not in questions_open or decisions[0].runs:
            for question, ask in (("share", self._shared), ("model", self._model)):
                if question in questions_open:
                    best, decided = ask(attempt, best)
                    decisions.append(decided)
        trainee.restore(best.end)
        trainee.revise(_AFTER.get(best.changes.get("lens_model", ""), {}))
        return step + steps, decisions

    def _lens(self, attempt: _Try, with_lens: _Attempt) -> tuple[_Attempt, Decision]:
        circle = self._trainee.widest_circle()
        without = attempt({"lens": False, "adaptation": "off"}, "no lens")
        if without is None:
            return with_lens, Decision("lens", True, f"{_NO_TIME} no lens")
        gain, error = _gain(with_lens, without)
        figures = (
            f"with the lens that was learned so far held-back pixels are {_signed(gain, error)} dB better, "
            f"and its circles of confusion reach {circle:.2f} px"
        )
        # Wide circles without a gain don't speak against a lens: where all photographs show a surface equally blurred,
        # a blurred texture explains them as well as a lens does.
        explains = gain > max(EXPLAINED, SURE * error)
        needless = circle < NO_CIRCLE or (not explains and circle < SMALL_CIRCLE) or gain < -WORTH - SURE * error
        decided = Decision(
            "lens",
            not needless,
            f"tried while training: {figures}",
            {"lens gain": gain, "lens error": error, "circle": circle},
        )
        return (without if needless else with_lens), decided

    def _shared(self, attempt: _Try, each: _Attempt) -> tuple[_Attempt, Decision]:
        stops = {view.exif and view.exif.f_number for view in self._trainee.views}
        known = None not in stops
        self._trainee.restore(each.end)
        apart = self._trainee.foci_apart()
        ways = [("exif", "one aperture times f-number")] if known else []
        ways.append(("aperture", "one aperture"))
        # Circles may be alike by chance or too small to compare, but photographs with different f-numbers can't share
        # one lens.
        if apart < FOCI_APART and not (known and len(stops) > 1):
            ways.insert(0, ("scene", "one lens"))
        told, found = [], {"apart": apart}
        for per, words in ways:
            shared = attempt({**each.changes, "lens_per": per}, words)
            if shared is None:
                told.append(f"{_NO_TIME} {words} for all")
                break
            gain, error = _gain(shared, each)
            told.append(f"{words} for all makes held-back pixels {_signed(gain, error)} dB better")
            found |= {f"{per} gain": gain, f"{per} error": error}
            if gain > -max(WORTH, error):
                return shared, Decision("lens_per_view", False, f"tried while training: {'; '.join(told)}", found)
        return each, Decision("lens_per_view", True, f"tried while training: {'; '.join(told)}", found)

    def _model(self, attempt: _Try, scatter: _Attempt) -> tuple[_Attempt, Decision]:
        points = attempt({**scatter.changes, **_LENS_POINTS}, "points of the lens")
        if points is None:
            return scatter, Decision("lens_samples", False, f"{_NO_TIME} points of the lens")
        gain, error = _gain(points, scatter)
        figures = f"points of the lens make held-back pixels {_signed(gain, error)} dB better than the scatter"
        better = gain > max(WORTH, LIKELY * error)
        return (points if better else scatter), Decision(
            "lens_samples",
            better,
            f"tried while training: {figures}",
            {"points gain": gain, "points error": error},
        )


# Tried are points of the lens, since only they show at once what the scatter lacks: after the same steps each
# Gaussian's own blur, a fifth as dear, can't be told from the scatter on photographs that a lens took
# (docs/notes/forward-models.md).
_LENS_POINTS = {"lens_model": "samples", "lens_samples_from": 0.0, "lens_rings": 1}
# Until the last fifth each Gaussian's own blur goes on with what the points began, since it takes one rasterisation.
_AFTER = {"samples": {"lens_rings_from": 0.8, "depth_every": 4}}


def questions(options: GaussianOptions) -> tuple[str, ...]:
    """The questions in lens_trials that other options don't already answer, in the order of the trials."""
    asked = {word for word in options.trials.lens_trials.split(",") if word}
    settled = {
        "lens": not options.lens.lens,
        "share": options.lens.lens_per != "view",
        "model": options.blur.lens_model != "scatter",
    }
    return tuple(word for word in QUESTIONS if word in asked and not settled[word])


def possible_models(options: GaussianOptions) -> tuple[ForwardModel, ...]:
    """The forward models that a training may use: those of its options, and those that a trial may introduce."""
    models = options.forward_models().models
    if options.lens.lens and "model" in questions(options):
        models += options.with_overrides(_LENS_POINTS).forward_models().models
    return models


def _gain(one: _Attempt, other: _Attempt) -> tuple[float, float]:
    """(mean over the views of the first attempt's PSNR minus the other's, standard error of the mean), dB."""
    differences = one.psnr - other.psnr
    # A view whose held-back pixels are all masked has no score.
    differences = differences[~np.isnan(differences)] if len(differences) > 1 else differences
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else math.inf
    return float(differences.mean()), spread / math.sqrt(len(differences))


def _signed(value: float, error: float) -> str:
    return f"{value:+.2f} ± {error:.2f}"
