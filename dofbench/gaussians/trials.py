"""What explains the photographs better, tried out while training, and then kept or left out.

Whether there is a lens, whether photographs share it, and which forward model is right can't be told from sparse
points: structure from motion finds points where a photograph is sharp. So training goes on a little in each of two
ways, from one state and through the same photographs in the same order, and both are scored on tiles of the training
photographs that no loss has looked at (`held_back.py`). Differences are paired by view. The state of the better
way is kept, so only the other one's steps are lost. Afterwards the tiles are trained on like all others.

Figures of a decision: "WAY gain" and "WAY error", how much better WAY explains held-back pixels than what it was
compared with, dB, and the standard error of that; "circle", what `Trainee.widest_circle` says, and "apart", what
`Trainee.foci_apart` does, pixels.
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
from dofbench.gaussians.forward.forward_model import ForwardModel
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.trial_options import QUESTIONS
from dofbench.learning.held_back import HeldBackScores

HELD_BACK = 0.08  # share of the tiles
VISITS = 2  # of each photograph in a trial, at least
MOST = 0.06  # share of the training that a trial may take, at most
NO_CIRCLE = 0.3  # px, radius: below it a photograph shows nothing of its lens
SMALL_CIRCLE = 1.0  # px, radius: below it a lens must explain something to stay
EXPLAINED = 0.01  # dB on held-back pixels: less is nothing; sharp photographs gave up to 0.003 (reports/lens)
WORTH = 0.05  # dB on held-back pixels below which the simpler way is as good
SURE = 2.0  # standard errors that what costs more must be better by
FOCI_APART = 1.0  # px that the same point's circles differ by between photographs that can't share a focus


class Trainee(Protocol):
    """A training that trials may be made with. Its snapshots are opaque: all that training changes, to come back to."""

    views: Sequence[TrainingView]

    def snapshot(self) -> Any:
        """Where it is."""

    def restore(self, snapshot: Any) -> None:
        """Go on from there, as often as you like."""

    def revise(self, changes: Mapping[str, Any]) -> None:
        """Go on with other options."""

    def train(self, step: int, count: int, total: int, progress: float, tell: Callable[[int, int], None]) -> None:
        """Take `count` steps after `step` of `total`, at `progress` or later; tell: how many are taken."""

    def held_back_scores(self, share: float) -> HeldBackScores:
        """How well the training photographs are explained where that share of them was held back."""

    def widest_circle(self) -> float:
        """Of the lenses learned so far, pixels (`blur_circles.widest_circle`)."""

    def foci_apart(self) -> float:
        """Of the lenses learned so far, pixels (`blur_circles.foci_apart`)."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A way that was tried: what it changes, where it ended, and PSNR on each view's held-back tiles."""

    changes: Mapping[str, Any]
    end: Any
    psnr: np.ndarray


class Trials:
    """Tries what the option lens_trials leaves open, once."""

    def __init__(self, trainee: Trainee, options: GaussianOptions):
        self._trainee = trainee
        self._open = questions(options) if options.lens.lens else ()
        self._at, self._share = options.trials.lens_trials_at, options.trials.lens_trials_steps

    @property
    def open(self) -> bool:
        """Whether something is still undecided."""
        return bool(self._open)

    def due(self, progress: float) -> bool:
        """Whether now is the time."""
        return self.open and progress >= self._at

    def length(self, total: int, views: int) -> int:
        """Steps of one trial, of a training of `total` steps."""
        return max(1, min(max(round(self._share * total), VISITS * views), round(MOST * total)))

    def decide(self, step: int, total: int, progress: float, tell: Progress = silent) -> tuple[int, list[Decision]]:
        """Try, and leave the trainee in the state of the best; returns the steps taken in all, and what was decided.

        tell: told what is tried, and how many of its steps are taken.
        """
        trainee, questions_open = self._trainee, self._open
        self._open = ()
        steps = min(self.length(total, len(trainee.views)), total - step)
        start = trainee.snapshot()

        def attempt(changes: Mapping[str, Any], words: str) -> _Attempt:
            trainee.restore(start)
            trainee.revise(changes)
            trainee.train(step, steps, total, progress, partial(tell, f"trying {words}"))
            views = trainee.held_back_scores(HELD_BACK).views
            return _Attempt(changes, trainee.snapshot(), np.array([psnr for psnr, _ in views.values()]))

        best, decisions = attempt({}, "what was learned so far"), []
        if "lens" in questions_open:
            best, decided = self._lens(attempt, best)
            decisions.append(decided)
        if "lens" not in questions_open or decisions[0].runs:
            for question, ask in (("share", self._shared), ("model", self._model)):
                if question in questions_open:
                    best, decided = ask(attempt, best)
                    decisions.append(decided)
        trainee.restore(best.end)
        trainee.revise(_AFTER.get(best.changes.get("lens_model"), {}))
        return step + steps, decisions

    def _lens(self, attempt, with_lens: _Attempt) -> tuple[_Attempt, Decision]:
        circle = self._trainee.widest_circle()
        without = attempt({"lens": False, "adaptation": "off"}, "no lens")
        gain, error = _gain(with_lens, without)
        figures = (
            f"with the lens that was learned so far held-back pixels are {_signed(gain, error)} dB better, "
            f"and its circles of confusion reach {circle:.2f} px"
        )
        # Wide circles that explain no more than painted blur would are no proof against a lens: of what all photographs
        # saw blurred alike both are true.
        explains = gain > max(EXPLAINED, SURE * error)
        needless = circle < NO_CIRCLE or (not explains and circle < SMALL_CIRCLE) or gain < -WORTH - SURE * error
        decided = Decision(
            "lens",
            not needless,
            f"tried while training: {figures}",
            {"lens gain": gain, "lens error": error, "circle": circle},
        )
        return (without if needless else with_lens), decided

    def _shared(self, attempt, each: _Attempt) -> tuple[_Attempt, Decision]:
        stops = {view.exif and view.exif.f_number for view in self._trainee.views}
        known = None not in stops
        self._trainee.restore(each.end)
        apart = self._trainee.foci_apart()
        ways = [("exif", "one aperture times f-number")] if known else []
        ways.append(("aperture", "one aperture"))
        # Circles may be alike by chance, or too small to tell; f-numbers that differ can't be one lens.
        if apart < FOCI_APART and not (known and len(stops) > 1):
            ways.insert(0, ("scene", "one lens"))
        told, found = [], {"apart": apart}
        for per, words in ways:
            shared = attempt({**each.changes, "lens_per": per}, words)
            gain, error = _gain(shared, each)
            told.append(f"{words} for all makes held-back pixels {_signed(gain, error)} dB better")
            found |= {f"{per} gain": gain, f"{per} error": error}
            if gain > -max(WORTH, error):
                return shared, Decision("lens_per_view", False, f"tried while training: {'; '.join(told)}", found)
        return each, Decision("lens_per_view", True, f"tried while training: {'; '.join(told)}", found)

    def _model(self, attempt, scatter: _Attempt) -> tuple[_Attempt, Decision]:
        own = attempt({**scatter.changes, **_OWN_BLUR}, "each Gaussian's own blur")
        gain, error = _gain(own, scatter)
        figures = f"each Gaussian's own blur makes held-back pixels {_signed(gain, error)} dB better than the scatter"
        better = gain > max(WORTH, SURE * error)
        return (own if better else scatter), Decision(
            "lens_samples", better, f"tried while training: {figures}", {"own blur gain": gain, "own blur error": error}
        )


# Each Gaussian blurred by itself: as fast as the scatter, and knows what hides what.
_OWN_BLUR = {"lens_model": "samples", "lens_samples_from": 0.0, "lens_rings": 0}
# The lens is sampled for the last fifth: several rasterisations a step, so not for longer.
_AFTER = {"samples": {"lens_rings": 1, "lens_rings_from": 0.8}}


def questions(options: GaussianOptions) -> tuple[str, ...]:
    """What lens_trials leaves open and the other options don't settle, in the order in which it is asked."""
    asked = {word for word in options.trials.lens_trials.split(",") if word}
    settled = {
        "lens": not options.lens.lens,
        "share": options.lens.lens_per != "view",
        "model": options.blur.lens_model != "scatter",
    }
    return tuple(word for word in QUESTIONS if word in asked and not settled[word])


def possible_models(options: GaussianOptions) -> tuple[ForwardModel, ...]:
    """The forward models that a training may look through: those of its options, and what a trial may bring."""
    models = options.forward_models().models
    if options.lens.lens and "model" in questions(options):
        models += options.with_overrides(_OWN_BLUR).forward_models().models
    return models


def _gain(one: _Attempt, other: _Attempt) -> tuple[float, float]:
    """(mean over the views of how much better the first is, its standard error), dB."""
    differences = one.psnr - other.psnr
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else math.inf
    return float(differences.mean()), spread / math.sqrt(len(differences))


def _signed(value: float, error: float) -> str:
    return f"{value:+.2f} ± {error:.2f}"
