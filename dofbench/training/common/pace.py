"""Progress of a training in shares of its steps, also where its length is given as time.

Schedules are shares of steps. A limit of time says nothing about steps, and stages differ in cost: a step with five
copies of the scene takes many times as long as one of the sharp view. If a schedule's shares were taken of time, the
cheap stages would get nearly all steps. So the steps that fit are estimated: before training a few steps of every stage
are timed and undone, and while it trains the estimate follows the pace that is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from dofbench.core.budget import Budget

Probe = Callable[[float], float]  # share of the training -> seconds of a step there, which is undone

_MEMORY = 30  # steps over which the pace is averaged
_AGAIN = (0.1, 0.4)  # shares of the training at which stages are timed again
_MOST = 0.02  # share of the budget after which no further stage is timed
_SHORT = 0.01  # share of the budget: a step that took less is timed twice, as the first may be slow
_LAST = math.nextafter(1.0, 0.0)
_OF_THE_PROCESS = {"_budget", "_preset", "_seconds", "_probe"}


class Pace:
    """How much of a training is over; ask for `progress` before every step.

    preset: steps of a training without a budget. seconds: tells the time that the budget counts. Only where time is
    limited are stages planned and timed.
    """

    def __init__(self, budget: Budget, preset: int, seconds: Callable[[], float]):
        self._budget, self._preset, self._seconds = budget, preset, seconds
        self._share, self._step, self._now = 0.0, 0, 0.0
        self._pace: float | None = None  # seconds of a step of cost 1
        self._stages: list[tuple[float, float, float]] = [(0.0, 1.0, 1.0)]  # start, end, cost of a step
        self._starts: Sequence[float] = ()
        self._probe: Probe | None = None
        self._again: list[float] = []
        self._ending: tuple[float, int, int] | None = None  # share and step at which it began, and its steps

    def plan(self, starts: Sequence[float], probe: Probe, *, again: bool = True) -> None:
        """Plan what is left of the training. starts: shares at which a step's cost may change. probe: times a step.
        again: whether stages can be timed while it trains too."""
        if self._budget.seconds is None:
            return
        self._starts, self._probe = starts, probe
        self._again = [share for share in _AGAIN if again and share > self._share]
        self._measure()

    def state(self) -> dict[str, Any]:
        """What a training that is interrupted needs to go on, for `restore`."""
        return {name: value for name, value in vars(self).items() if name not in _OF_THE_PROCESS}

    def restore(self, state: Mapping[str, Any], probe: Probe) -> None:
        """Go on from an earlier `state`. probe: as for `plan`."""
        vars(self).update(state)
        self._probe = probe

    def _measure(self) -> None:
        """Time the stages, the last before those between it and the present one, until that has taken its share of the
        budget."""
        edges = sorted({self._share, 1.0, *(start for start in self._starts if self._share < start < 1)})
        if self._probe is None or len(edges) == 2 or self._budget.seconds is None:
            return
        ends = self._seconds() + _MOST * self._budget.seconds
        last = len(edges) - 2
        here = self._timed(edges[0]) if self._pace is None else self._pace * self._cost_at(self._share)
        costs = {0: here, last: self._timed(edges[last])}
        open_spans = [(0, last)]
        while open_spans and self._seconds() < ends:
            first, end = open_spans.pop(0)
            middle = (first + end) // 2
            if middle > first:
                costs[middle] = self._timed(edges[middle])
                open_spans += [(first, middle), (middle, end)]
        # What wasn't timed costs as much as the next that was: no later stage starves.
        every = [next(costs[later] for later in range(index, last + 1) if later in costs) for index in range(last + 1)]
        self._stages = [(low, high, cost) for (low, high), cost in zip(pairwise(edges), every, strict=True)]
        self._pace = 1.0
        self._now = self._seconds()

    def _timed(self, share: float) -> float:
        """Seconds of a step at a share of the training, the shorter of two where they are short."""
        assert self._probe is not None and self._budget.seconds is not None
        took = self._probe(share)
        if took < _SHORT * self._budget.seconds:
            took = min(took, self._probe(share))
        return max(took, 1e-9)

    def progress(self, step: int) -> float:
        """The share of the training that is over after `step`; 1 or more when the budget is spent."""
        budget = self._budget
        if self._ending is not None:
            share, start, steps = self._ending
            spent = budget.seconds is not None and self._seconds() >= budget.seconds
            over = spent or step == budget.steps or step >= start + steps
            return 1.0 if over else share + (1 - share) * (step - start) / steps
        if budget.seconds is None:
            return step / (budget.steps or self._preset)
        now, taken = self._seconds(), step - self._step
        if now >= budget.seconds or (budget.steps is not None and step >= budget.steps):
            return 1.0
        if taken > 0:
            self._follow((now - self._now) / taken, taken)
            self._share = min(_LAST, self._share + taken / self._steps_in_all(step - taken, self._now))
        self._step, self._now = step, now
        if self._again and self._share >= self._again[0]:  # a scene that has grown costs more, not equally everywhere
            del self._again[0]
            self._measure()
        return self._share

    def resume(self, step: int) -> None:
        """Go on after steps outside the schedule's pace, such as those of A/B checks: they count as steps, their time
        says nothing of what the next ones take."""
        if self._budget.seconds is None:
            return
        taken = step - self._step
        self._share = min(_LAST, self._share + taken / self._steps_in_all(self._step, self._now))
        self._step, self._now = step, self._seconds()

    def end(self, share: float, step: int, steps: int) -> None:
        """Go on at `share` of the training after `step`, and end after `steps` more, or when the budget is spent."""
        self._ending = share, step, steps

    def _follow(self, seconds: float, taken: int) -> None:
        """Update the pace by what the last steps took, each `seconds`."""
        pace = seconds / self._cost_at(self._share)
        if self._pace is None:
            self._pace = pace
        else:
            kept = (1 - 1 / _MEMORY) ** taken
            self._pace = kept * self._pace + (1 - kept) * pace

    def _cost_at(self, share: float) -> float:
        return next(cost for _, high, cost in self._stages if share < high)

    def _steps_in_all(self, step: int, now: float) -> float:
        """Steps of a whole training at the rate at which the rest of it fits into the rest of the budget."""
        assert self._budget.seconds is not None and self._pace is not None
        left = 1 - self._share
        costs = [(high - max(low, self._share)) * cost for low, high, cost in self._stages if high > self._share]
        fitting = (self._budget.seconds - now) / max(self._pace * sum(costs), 1e-12)
        if self._budget.steps is not None:
            fitting = min(fitting, (self._budget.steps - step) / left)
        return max(fitting, 1.0)
