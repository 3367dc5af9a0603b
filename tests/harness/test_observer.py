"""Clock, budget and the times at which the curve is taken."""

from __future__ import annotations

import itertools
import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import ONE_STEP

from dofbench.core.budget import Budget
from dofbench.core.clock import Stopwatch
from dofbench.core.errors import Status
from dofbench.core.progress import Silent
from dofbench.running.observer import CURVE_FACTOR, CURVE_POINTS, TrainingObserver


class ManualClock(Stopwatch):
    """A stopwatch whose time is set by the test."""

    now = 0.0

    @property
    def wall(self) -> float:
        return self.now


def observer(budget: Budget, clock: Stopwatch | None = None, evaluate=lambda: {"psnr": 1.0}) -> TrainingObserver:
    return TrainingObserver(budget, clock or ManualClock(), Stopwatch(), evaluate, Silent())


def train(watch: TrainingObserver, clock: ManualClock | None = None, seconds_a_step: float = 0.0) -> int:
    for step in range(1, 100_000):
        if clock is not None:
            clock.now += seconds_a_step
        if not watch.after_step(step, 1.0 / step):
            return step
    raise AssertionError("never stopped")


@given(st.integers(1, 5000))
def test_a_budget_of_steps_is_kept(steps: int) -> None:
    watch = observer(Budget(steps=steps))
    assert train(watch) == steps
    watch.finish(steps)
    taken = [point.steps for point in watch.curve]
    assert taken[0] == 1 and taken[-1] == steps
    assert taken == sorted(set(taken)) and len(taken) <= CURVE_POINTS + 2


def test_a_budget_of_seconds_is_kept_and_gives_the_same_points() -> None:
    clock = ManualClock()
    by_time = observer(Budget(seconds=100.0), clock)
    assert train(by_time, clock, 0.1) == pytest.approx(1000, abs=ONE_STEP)
    by_steps = observer(Budget(steps=1000))
    train(by_steps)
    assert [p.steps for p in by_time.curve] == pytest.approx([p.steps for p in by_steps.curve], abs=ONE_STEP)


def test_whichever_comes_first() -> None:
    clock = ManualClock()
    assert train(observer(Budget(steps=50, seconds=100.0), clock), clock, 1.0) == 50
    clock = ManualClock()
    assert train(observer(Budget(steps=500, seconds=100.0), clock), clock, 1.0) == 100


def test_points_are_evenly_spaced_on_a_log_axis() -> None:
    watch = observer(Budget(steps=100_000 - 1))
    train(watch)
    later = [point.steps for point in watch.curve][3:]
    for one, two in itertools.pairwise(later):
        # Both are rounded to whole steps.
        assert two == pytest.approx(CURVE_FACTOR * one, abs=(1 + CURVE_FACTOR) * ONE_STEP)


@pytest.mark.parametrize(
    ("seconds_a_step", "each", "count"),
    [(0.001, 0.5, 16), (0.001, 2.0, 5), (0.1, 3.0, 7), (0.1, 10.0, 3), (0.1, 1000.0, 2)],
)
def test_evaluation_takes_no_longer_than_training_or_ten_seconds(
    seconds_a_step: float, each: float, count: int
) -> None:
    """A thousand steps. With the first point and the last there are at most sixteen; earlier ones are left out."""
    clock, evaluating = ManualClock(), ManualClock()

    def slow() -> dict[str, float]:
        evaluating.now += each
        return {}

    watch = TrainingObserver(Budget(steps=1000), clock, evaluating, slow, Silent())
    for step in range(1, 1001):
        clock.now += seconds_a_step
        watch.after_step(step, 1.0 / step)
        assert len(watch.curve) == 1 or evaluating.wall <= max(10, 0.5 * clock.now)
    watch.finish(1000)
    steps = [point.steps for point in watch.curve]
    whole = observer(Budget(steps=1000))
    train(whole)
    later = [point.steps for point in whole.curve]
    assert len(steps) == min(count, len(later) + 1)
    assert steps[0] == 1 and steps[-1] == 1000 and set(steps) <= {*later, 1000}
    assert count == 2 or evaluating.wall <= max(10, 0.5 * 1000 * seconds_a_step)


def test_the_clock_stands_still_while_it_evaluates() -> None:
    clock, evaluating = Stopwatch(), Stopwatch()

    def slow() -> dict[str, float]:
        time.sleep(0.05)
        return {}

    watch = TrainingObserver(Budget(steps=3), clock, evaluating, slow, Silent())
    with clock.running():
        train(watch)
    assert evaluating.wall >= 0.05 > clock.wall


def test_the_loss_of_a_point_is_the_mean_since_the_one_before() -> None:
    watch = observer(Budget(steps=3))
    for step, loss in enumerate([4.0, 1.0, 2.0], start=1):
        watch.after_step(step, loss)
    watch.finish(3)
    assert watch.curve[0].loss == 4.0
    assert math.fsum(p.loss for p in watch.curve[1:]) in (1.5, 3.0)  # one point of two steps, or two of one


@pytest.mark.parametrize("loss", [math.nan, math.inf, -math.inf])
def test_a_non_finite_loss_stops_as_diverged(loss: float) -> None:
    watch = observer(Budget(steps=10))
    assert watch.after_step(1, 1.0)
    assert not watch.after_step(2, loss)
    assert watch.failure() == (Status.DIVERGED, f"loss is {loss} at step 2")
    assert [event.step for event in watch.nonfinite] == [2]


def test_a_first_step_beyond_the_budget_is_out_of_time() -> None:
    clock = ManualClock()
    watch = observer(Budget(seconds=1.0), clock)
    clock.now = 1.5
    assert not watch.after_step(1, 1.0)
    assert watch.failure()[0] is Status.OUT_OF_TIME
    never = observer(Budget(seconds=1.0), clock)
    assert never.failure()[0] is Status.OUT_OF_TIME


def test_going_on_after_the_end_is_refused() -> None:
    watch = observer(Budget(steps=1))
    assert not watch.after_step(1, 1.0)
    with pytest.raises(RuntimeError, match="told to stop"):
        watch.after_step(2, 1.0)


def test_no_budget_is_an_error() -> None:
    with pytest.raises(ValueError, match="neither"):
        observer(Budget()).after_step(1, 1.0)
