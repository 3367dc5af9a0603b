"""A training whose length is given as time keeps the shares of its schedule, by a clock that costs nothing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE, ONE_STEP, PACED_SHARE

from dofbench.core.budget import Budget
from dofbench.training.common.pace import Pace


class Training:
    """A training whose steps take what `cost` says, by share of the training and number of the step. timing: seconds
    that it took to time stages."""

    def __init__(self, cost: Callable[[float, int], float]):
        self.cost, self.time, self.step, self.timing = cost, 0.0, 0, 0.0

    def seconds(self) -> float:
        return self.time

    def probe(self, share: float) -> float:
        took = self.cost(share, self.step)
        self.time += took
        self.timing += took
        return took

    def run(self, budget: Budget, starts: list[float], preset: int = 100) -> list[float]:
        """The share at each step."""
        pace, shares = Pace(budget, preset, self.seconds), []
        pace.plan(starts, self.probe)
        while (share := pace.progress(self.step)) < 1:
            shares.append(share)
            self.time += self.cost(share, self.step)
            self.step += 1
        return shares


def stage_costs(starts: list[float], costs: list[float]) -> Callable[[float, int], float]:
    return lambda share, step: costs[sum(share >= start for start in starts)]


def by_stage(shares: list[float], starts: list[float]) -> list[float]:
    counts = Counter(sum(share >= start for start in starts) for share in shares)
    return [counts[stage] / len(shares) for stage in range(len(starts) + 1)]


STAGES = st.lists(st.floats(0.05, 0.9), min_size=1, max_size=3, unique_by=lambda start: round(start, 1)).map(sorted)


@given(STAGES, st.lists(st.floats(0.01, 1.0), min_size=4, max_size=4))
def test_every_stage_gets_its_share_of_the_steps_whatever_a_step_of_it_costs(starts, costs) -> None:
    edges = [0.0, *starts, 1.0]
    planned = [high - low for low, high in pairwise(edges)]
    shares = Training(stage_costs(starts, costs)).run(Budget(seconds=1000.0), starts)
    for found, share in zip(by_stage(shares, starts), planned, strict=True):
        assert found >= share - PACED_SHARE
    assert shares == sorted(shares)


def test_the_expensive_stage_would_starve_by_time() -> None:
    """What this is for: a blur that costs nine times as much from the middle on."""
    training = Training(stage_costs([0.5], [0.1, 0.9]))
    shares = training.run(Budget(seconds=100.0), [0.5])
    assert by_stage(shares, [0.5]) == pytest.approx([0.5, 0.5], abs=PACED_SHARE)
    assert 100.0 <= training.time < 100.0 + 0.9  # the last step may be over time
    assert len(shares) == pytest.approx((100.0 - training.timing) / 0.5, rel=PACED_SHARE)


def test_a_scene_that_grows_is_followed() -> None:
    """A step takes three times as long at the end. By time the first half of the schedule would get log 2 / log 3 of
    the steps: what is off is less than half of that."""
    shares = Training(lambda share, step: 0.05 * (1 + 2 * share)).run(Budget(seconds=200.0), [0.5])
    first, _ = by_stage(shares, [0.5])
    assert abs(first - 0.5) < (math.log(2) / math.log(3) - 0.5) / 2


def test_time_is_used_up_and_steps_end_it_before() -> None:
    training = Training(lambda share, step: 1.0)
    assert len(training.run(Budget(seconds=50.0), [])) == 50
    shares = Training(lambda share, step: 1.0).run(Budget(steps=20, seconds=50.0), [0.5])
    assert len(shares) == 20 and abs(sum(share < 0.5 for share in shares) - 10) <= ONE_STEP


@pytest.mark.parametrize(("budget", "length"), [(Budget(), 100), (Budget(steps=40), 40)])
def test_without_a_limit_of_time_progress_is_the_share_of_steps_and_nothing_is_timed(
    budget: Budget, length: int
) -> None:
    training = Training(lambda share, step: 1.0)
    training.probe = pytest.fail  # type: ignore[method-assign, assignment]
    assert training.run(budget, [0.5]) == [step / length for step in range(length)]


def test_steps_of_checks_count_and_their_time_does_not() -> None:
    pace, clock = Pace(Budget(seconds=100.0), 100, lambda: clock[0]), [0.0]
    pace.plan([], lambda share: 1.0)
    for step in range(1, 21):
        clock[0] += 1.0
        share = pace.progress(step)
    clock[0] += 30.0  # ten steps of checks that took thirty seconds
    pace.resume(30)
    assert share < pace.progress(30) == pytest.approx(0.3, rel=FLOAT64_VALUE)
    clock[0] += 1.0
    # Fifty seconds are left for the last seventy hundredths.
    assert pace.progress(31) == pytest.approx(0.3 + 0.7 / 50, rel=FLOAT64_VALUE)


@pytest.mark.parametrize("budget", [Budget(steps=100), Budget(seconds=100.0), Budget(steps=100, seconds=1000.0)])
def test_a_training_can_end_before_its_budget(budget: Budget) -> None:
    pace, clock = Pace(budget, 100, lambda: clock[0]), [0.0]
    pace.plan([], lambda share: 1.0)
    for step in range(1, 41):
        clock[0] += 1.0
        pace.progress(step)
    pace.end(0.8, 40, 10)
    shares = [pace.progress(step) for step in range(40, 51)]
    assert shares == pytest.approx([0.8 + 0.02 * step for step in range(11)], rel=FLOAT64_VALUE)


def test_the_end_keeps_to_the_budget() -> None:
    pace, clock = Pace(Budget(steps=45, seconds=100.0), 100, lambda: clock[0]), [0.0]
    pace.end(0.8, 40, 10)
    assert pace.progress(44) < 1 <= pace.progress(45)
    assert pace.progress(41) < 1
    clock[0] = 100.0
    assert pace.progress(41) >= 1
