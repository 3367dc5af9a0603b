"""The harness's side of training: budget, curve, and the first NaN."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from dofbench.core.budget import Budget
from dofbench.core.clock import Stopwatch
from dofbench.core.contracts import NonFinite
from dofbench.core.errors import Status
from dofbench.core.progress import Progress
from dofbench.evaluation.results.result import CurvePoint
from dofbench.running.checkpoints import Checkpoints
from dofbench.running.snapshots import Snapshots

CURVE_FACTOR = 1.6  # ratio of two neighbouring evaluation times
CURVE_POINTS = 14  # thresholds below the whole budget: the first is at 1.6^-14, 0.14 % of it
FREE_SECONDS = 10.0  # that evaluation may take during any training
SHARE_OF_TRAINING = 0.5  # that it may take of a longer one, at every moment of it

Evaluate = Callable[[], dict[str, float]]


def share_spent(budget: Budget, step: int, seconds: float) -> float:
    """How much of the budget is gone, 0 ... 1 (and beyond): the larger of steps' and seconds' shares."""
    shares = []
    if budget.steps is not None:
        shares.append(step / budget.steps)
    if budget.seconds is not None:
        shares.append(seconds / budget.seconds)
    if not shares:
        raise ValueError("budget: expected steps or seconds, found neither")
    return max(shares)


class TrainingObserver:
    """Implements `dofbench.core.contracts.Observer`.

    After the first step, and whenever the share of the budget that is spent passes one of the
    thresholds `CURVE_FACTOR ** -k`, it stops the clock and evaluates: the same points on a log axis
    whether the budget is in steps or in seconds. Where they take longer than half the training so far, or all of them
    would in the end, as with fields that are seen through a lens ray by ray, the earlier ones are skipped. A non-finite
    loss ends the training as diverged.

    evaluate: scores of the method as it is now, by column. log: called with each point of the curve. snapshots: saved
    every few seconds. checkpoints: saved every few minutes. The time of all three counts neither as training nor as
    evaluation.
    """

    def __init__(
        self,
        budget: Budget,
        clock: Stopwatch,
        evaluating: Stopwatch,
        evaluate: Evaluate,
        progress: Progress,
        log: Callable[[CurvePoint], object] | None = None,
        snapshots: Snapshots | None = None,
        checkpoints: Checkpoints | None = None,
    ):
        self._budget, self._clock, self._evaluating = budget, clock, evaluating
        self._evaluate, self._progress, self._log, self._snapshots = evaluate, progress, log, snapshots
        self._checkpoints = checkpoints
        self._thresholds = [CURVE_FACTOR**-k for k in range(CURVE_POINTS, 0, -1)]
        self._losses: list[float] = []
        self._stopped = False
        self.first_step_seconds: float | None = None
        self.steps = 0
        self.curve: list[CurvePoint] = []
        self.nonfinite: list[NonFinite] = []

    def seconds(self) -> float:
        """Training seconds so far, as the budget counts them, evaluation excluded."""
        return self._clock.cpu if self._budget.processor else self._clock.wall

    def after_step(self, step: int, loss: float) -> bool:
        """See `Observer.after_step`. Raises RuntimeError when the method goes on after it was told to stop."""
        if self._stopped:
            raise RuntimeError(f"the method took step {step} after it was told to stop")
        seconds = self.seconds()
        if self.first_step_seconds is None:
            self.first_step_seconds = seconds
        self.steps = step
        loss = float(loss)
        if not math.isfinite(loss):
            self.nonfinite.append(NonFinite(step=step, view="", stage="loss", detail=f"loss is {loss}"))
            self._stopped = True
            return False
        self._losses.append(loss)
        spent = share_spent(self._budget, step, seconds)
        due = not self.curve
        while self._thresholds and spent >= self._thresholds[0]:
            del self._thresholds[0]
            due = True
        self._stopped = spent >= 1
        if due and not self._stopped and self._affordable(seconds / spent):  # at the end `finish` evaluates
            self._add_point(step)
        with self._clock.paused():
            self._show(step, loss, seconds)
            if self._checkpoints is not None and not self._stopped and self._checkpoints.due():
                self._checkpoints.save(step, self.state())
            # After the checkpoints: who sees the first snapshot may interrupt and resume.
            if self._snapshots is not None and self._snapshots.due():
                self._snapshots.save(step)
        return not self._stopped

    def state(self) -> dict[str, Any]:
        """What a later process needs to go on, for `resume_from`."""
        clocks = {"train": self._clock, "evaluate": self._evaluating}
        return {
            "seconds": {name: (clock.wall, clock.cpu) for name, clock in clocks.items()},
            "thresholds": self._thresholds,
            "losses": self._losses,
            "first": self.first_step_seconds,
            "steps": self.steps,
            "curve": [point.model_dump() for point in self.curve],
        }

    def resume_from(self, state: Mapping[str, Any]) -> None:
        """Go on from the `state` of an earlier process: its clocks, curve and losses count."""
        self._clock.add(*state["seconds"]["train"])
        self._evaluating.add(*state["seconds"]["evaluate"])
        self._thresholds, self._losses = state["thresholds"], state["losses"]
        self.first_step_seconds, self.steps = state["first"], state["steps"]
        self.curve = [CurvePoint.model_validate(point) for point in state["curve"]]
        if self._log is not None:
            for point in self.curve:
                self._log(point)

    def stage(self, name: str, done: int, total: int) -> None:
        """See `Observer.stage`."""
        with self._clock.paused():
            self._progress.update(name, done, total)

    def _show(self, step: int, loss: float, seconds: float) -> None:
        budget, detail = self._budget, f"loss {loss:.4f}"
        left = None if budget.seconds is None else max(0.0, budget.seconds - seconds)
        if budget.seconds is None or (budget.steps and step / budget.steps > seconds / budget.seconds):
            self._progress.update("training", step, budget.steps or 0, detail, left)
        else:
            spent = min(seconds, budget.seconds)
            self._progress.update("training (s)", spent, budget.seconds, f"step {step}, {detail}", left)

    def finish(self, steps: int) -> None:
        """Evaluate once more, at the end of a training that went well."""
        if not self.curve or self.curve[-1].steps != steps:
            self._add_point(steps)

    def failure(self) -> tuple[Status, str] | None:
        """The typed failure that the observer itself saw, with its message."""
        if self.nonfinite:
            event = self.nonfinite[0]
            return Status.DIVERGED, f"{event.detail} at step {event.step}"
        limit = self._budget.seconds
        if limit is not None and (self.first_step_seconds is None or self.first_step_seconds > limit):
            took = self.seconds() if self.first_step_seconds is None else self.first_step_seconds
            return Status.OUT_OF_TIME, f"the first step wasn't done after {took:.1f} s, the budget is {limit:g} s"
        return None

    def _affordable(self, whole: float) -> bool:
        """Whether there is time for this point now, and for all later ones in the end. whole: seconds that training
        will take."""
        if not self.curve:
            return True
        taken = self._evaluating.wall
        each, later = taken / len(self.curve), len(self._thresholds) + 1  # and the end
        now = taken + each <= max(FREE_SECONDS, SHARE_OF_TRAINING * self._clock.wall)
        return now and taken + each * (1 + later) <= max(FREE_SECONDS, SHARE_OF_TRAINING * whole)

    def _add_point(self, step: int) -> None:
        seconds = self._clock.wall
        with self._clock.paused(), self._evaluating.running():
            scores = self._evaluate()
        loss = math.fsum(self._losses) / len(self._losses) if self._losses else None
        self._losses.clear()
        self.curve.append(
            CurvePoint(train_s=seconds, train_cpu_s=self._clock.cpu, steps=step, loss=loss, scores=scores)
        )
        if self._log is not None:
            with self._clock.paused():
                self._log(self.curve[-1])


class OneStep:
    """An observer that ends a training after its first step and looks at nothing."""

    def seconds(self) -> float:
        """No clock runs."""
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        """Stop. Raises RuntimeError when the method goes on all the same."""
        if step > 1:
            raise RuntimeError(f"the method took step {step} after it was told to stop")
        return False

    def stage(self, name: str, done: int, total: int) -> None:
        """Nobody looks."""
