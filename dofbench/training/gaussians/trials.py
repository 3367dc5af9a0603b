"""Trials while training: A/B checks of two settings, scored on held-out pixels.

Whether there is a lens, whether views share it, and which forward model is right can't be decided from sparse points,
because structure from motion finds points where an image is sharp. So training continues for some steps with each
setting, from the same state and on the same views in the same order. Both are scored on tiles of the training views
that no loss has used (`held_out.py`), and differences are paired by view. The better state is kept, so only the steps
of the other are lost; afterwards the tiles are used in training.

In a training limited in time, trials get a share of it. A trial that would not end within it is given up: its question
stays undecided, and the setting as it was.

Figures of a decision: "NAME gain", the PSNR on held-out pixels, dB, by which the setting NAME is better than the one it
was compared with; "NAME error", the gain's standard error; "circle", `widest_circle`, and "apart", `foci_apart`, px.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from dofbench.core.contracts import Decision, TrainingView
from dofbench.core.progress import Update, silent
from dofbench.training.common.held_out import HeldOutScores
from dofbench.training.common.reproduction import Reproduction
from dofbench.training.gaussians.forward_model import ForwardModel
from dofbench.training.gaussians.gaussian_options import QUESTIONS, GaussianOptions

HELD_BACK = 0.08  # share of the tiles
VISITS = 2  # smallest number of visits of each photograph in a trial
MOST = 0.06  # largest share of the training's steps that a trial may take
LONGEST = 200  # steps of a trial, unless its visits need more: longer ones decide alike (docs/notes/lens.md)
MOST_TIME = 0.35  # largest share of a limited training time that all trials may take
BLURRIER = -3.0  # dB: with less detail than this, half the photograph's, a rendering is blurrier than the photograph
NO_CIRCLE = 0.3  # px: smaller CoC radii are invisible in an image
EXPLAINED = 0.01  # dB, held-out: a lens with a smaller gain isn't kept (reports/lens)
WORTH = 0.05  # dB, held-out: with a smaller difference the simpler setting counts as equally good
# Standard errors by which a lens, or the forward model that costs more, must be better. No more: views with widely
# differing CoCs differ widely in their gains.
LIKELY = 1.0
FOCI_APART = 1.0  # px: views in which a point's CoC radii differ by more can't share a focus

Left = Callable[[], float]  # seconds left of a limited time


def unlimited() -> float:
    """Time without a limit."""
    return math.inf


class Trainee(Protocol):
    """A training on which trials can be made. A snapshot holds all that training changes, in any type."""

    @property
    def views(self) -> Sequence[TrainingView]:
        """The training views."""

    def snapshot(self) -> Any:
        """Copy everything that training changes."""

    def restore(self, snapshot: Any) -> None:
        """Return to a snapshot, which stays usable."""

    def revise(self, changes: Mapping[str, Any]) -> None:
        """Change options; training continues with them."""

    def train(
        self, step: int, count: int, total: int, progress: float, tell: Callable[[int, int], None], left: Left
    ) -> bool:
        """Take `count` steps after `step` of `total`, at `progress` or later. tell: called with the number of steps
        taken and `count`. False, after fewer steps, if `count` would take longer than the seconds left."""

    def held_out_scores(self, share: float) -> HeldOutScores:
        """Score the training views on their held-out tiles. share: of the tiles."""

    def widest_circle(self) -> float:
        """See `lens_renderer.widest_circle`, px."""

    def foci_apart(self) -> float:
        """See `lens_renderer.foci_apart`, px."""

    def reproduction(self) -> Reproduction:
        """Compare the training photographs with their renderings."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A finished trial. changes: of options. end: snapshot at its end. psnr: (V,) on held-out tiles, dB."""

    changes: Mapping[str, Any]
    end: Any
    psnr: np.ndarray


_Try = Callable[[Mapping[str, Any], str], _Attempt | None]  # changes and a name -> attempt; None: no time
_NO_TIME = "not tested: too little time left for a trial of"


class Trials:
    """Decides the questions of the option lens_trials by trials, once in a training. open_questions: still to come."""

    def __init__(self, trainee: Trainee, options: GaussianOptions):
        self._trainee = trainee
        self.open_questions = questions(options) if options.lens.lens else ()
        self._at, self._share = options.trials.lens_trials_at, options.trials.lens_trials_steps
        self._least = options.trials.lens_trials_from

    @property
    def open(self) -> bool:
        """Whether the trials are still to come."""
        return bool(self.open_questions)

    def settle(self, question: str) -> None:
        """Ask this question no more: it was answered otherwise."""
        self.open_questions = tuple(one for one in self.open_questions if one != question)

    def due(self, step: int, progress: float) -> bool:
        """Whether the trials take place after `step`: at their time, but not before every view has been visited."""
        return self.open and progress >= self._at and step >= len(self._trainee.views)

    def length(self, total: int, views: int) -> int:
        """Steps of one trial, in a training of `total` steps on `views` views."""
        enough = min(round(self._share * total), LONGEST)
        return max(1, min(max(enough, VISITS * views), round(MOST * total)))

    def decide(
        self, step: int, total: int, progress: float, tell: Update = silent, left: Left = unlimited
    ) -> tuple[int, list[Decision]]:
        """Run the trials and leave the trainee in the best one's state; returns the steps taken in all, and decisions.

        total: estimated where time is limited. tell: called with the name of a trial, the steps taken, and its length.
        left: seconds that all trials may still take.
        """
        trainee, questions_open = self._trainee, self.open_questions
        self.open_questions = ()
        steps = min(self.length(total, len(trainee.views)), total - step)
        start = trainee.snapshot()

        def attempt(changes: Mapping[str, Any], words: str, left: Left = left) -> _Attempt | None:
            trainee.restore(start)
            trainee.revise(changes)
            if not trainee.train(step, steps, total, progress, partial(tell, f"trial: {words}"), left):
                return None
            views = trainee.held_out_scores(HELD_BACK).views
            return _Attempt(changes, trainee.snapshot(), np.array([psnr for psnr, _ in views.values()]))

        # The first trial is no detour, since training goes on as it was, so its time isn't limited.
        best, decisions = attempt({}, "the current setting", unlimited), []
        assert best is not None
        if "lens" in questions_open and self._least > 0 and (missing := self._not_reconstructed()) is not None:
            trainee.restore(best.end)
            return step + steps, [missing]
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

    def _not_reconstructed(self) -> Decision | None:
        """The decision to ask nothing about a lens; None where the training photographs are reproduced."""
        shown = self._trainee.reproduction()
        if shown.psnr >= self._least and shown.detail >= BLURRIER:
            return None
        reason = (
            f"scene not reconstructed: training photographs at {shown.psnr:.1f} dB, their detail at "
            f"{shown.detail:+.1f} dB; nothing is decided about a lens"
        )
        return Decision("lens", True, reason, {"reproduced": shown.psnr, "detail": shown.detail})

    def _lens(self, attempt: _Try, with_lens: _Attempt) -> tuple[_Attempt, Decision]:
        circle = self._trainee.widest_circle()
        without = attempt({"lens": False, "adaptation": "off"}, "no lens")
        if without is None:
            return with_lens, Decision("lens", True, f"{_NO_TIME} no lens")
        gain, error = _gain(with_lens, without)
        kept = keeps_lens(gain, error, circle)
        reason = f"{_psnr(gain, error)} with the lens, CoC radius {circle:.2f} px"
        figures = {"lens gain": gain, "lens error": error, "circle": circle}
        return (with_lens if kept else without), Decision("lens", kept, reason, figures)

    def _shared(self, attempt: _Try, each: _Attempt) -> tuple[_Attempt, Decision]:
        stops = {view.exif and view.exif.f_number for view in self._trainee.views}
        known = None not in stops
        self._trainee.restore(each.end)
        apart = self._trainee.foci_apart()
        ways = [("exif", "one aperture times f-number")] if known else []
        ways.append(("aperture", "one aperture"))
        # CoCs may be alike by chance or too small to compare, but views with different f-numbers can't share one lens.
        if apart < FOCI_APART and not (known and len(stops) > 1):
            ways.insert(0, ("scene", "one lens"))
        reasons, figures = [], {"apart": apart}
        for per, words in ways:
            shared = attempt({**each.changes, "lens_per": per}, words)
            if shared is None:
                reasons.append(f"{_NO_TIME} {words} for all")
                break
            gain, error = _gain(shared, each)
            reasons.append(f"{_psnr(gain, error)} with {words} for all")
            figures |= {f"{per} gain": gain, f"{per} error": error}
            if gain > -max(WORTH, error):
                return shared, Decision("lens_per_view", False, "; ".join(reasons), figures)
        return each, Decision("lens_per_view", True, "; ".join(reasons), figures)

    def _model(self, attempt: _Try, scatter: _Attempt) -> tuple[_Attempt, Decision]:
        points = attempt({**scatter.changes, **_LENS_POINTS}, "aperture samples")
        if points is None:
            return scatter, Decision("lens_samples", False, f"{_NO_TIME} aperture samples")
        gain, error = _gain(points, scatter)
        better = gain > max(WORTH, LIKELY * error)
        reason, figures = (
            f"{_psnr(gain, error)} against the scatter renderer",
            {"points gain": gain, "points error": error},
        )
        return (points if better else scatter), Decision("lens_samples", better, reason, figures)


def keeps_lens(gain: float, error: float, circle: float) -> bool:
    """Whether the check keeps a lens. gain, error: of held-out PSNR with it, dB. circle: `widest_circle`, px."""
    return circle >= NO_CIRCLE and gain > max(EXPLAINED, LIKELY * error)


# Aperture samples, since only they show at once what the scatter renderer lacks: after the same steps each Gaussian's
# own blur, at a fifth of the cost, can't be told from it on ray-traced defocus (docs/notes/forward-models.md).
_LENS_POINTS = {"lens_model": "samples", "lens_samples_from": 0.0, "lens_rings": 1}
# Until the last fifth each Gaussian's own blur continues, since it takes one rasterisation.
_AFTER = {"samples": {"lens_rings_from": 0.8, "depth_every": 4}}


def questions(options: GaussianOptions) -> tuple[str, ...]:
    """The questions in lens_trials that other options don't answer, in the order of the trials."""
    asked = {word for word in options.trials.lens_trials.split(",") if word}
    settled = {
        "lens": not options.lens.lens,
        "share": options.lens.lens_per != "view",
        "model": options.blur.lens_model != "scatter",
    }
    return tuple(word for word in QUESTIONS if word in asked and not settled[word])


def possible_models(options: GaussianOptions) -> tuple[ForwardModel, ...]:
    """The forward models that a training may use, by its options or after a trial."""
    models = options.forward_models().models
    if options.lens.lens and "model" in questions(options):
        models += options.with_overrides(_LENS_POINTS).forward_models().models
    return models


def _gain(one: _Attempt, other: _Attempt) -> tuple[float, float]:
    """(mean over the views of the first attempt's PSNR minus the other's, standard error of the mean), dB."""
    differences = one.psnr - other.psnr
    # A view whose held-out pixels are all masked has no score.
    differences = differences[~np.isnan(differences)] if len(differences) > 1 else differences
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else math.inf
    return float(differences.mean()), spread / math.sqrt(len(differences))


def _psnr(gain: float, error: float) -> str:
    return f"held-out PSNR {gain:+.2f} ± {error:.2f} dB"
