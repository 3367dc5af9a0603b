"""The time left that progress shows, with a simulated clock: realistic from the first line on."""

from __future__ import annotations

import re
from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from tolerances import DIFFERENCE_OF_TIMES, FLOAT64_VALUE

from dofbench.core.budget import Budget
from dofbench.core.clock import Stopwatch
from dofbench.core.progress import Terminal
from dofbench.core.time_left import Remaining
from dofbench.running.observer import TrainingObserver

STEPS, STEP = 3000, 0.05
COLD = 80.0  # seconds until the first step is done


class Clock:
    """Stands still until it is told."""

    def __init__(self, start: float = 1000.0):
        self.now = start

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("time.monotonic", clock)
    return clock


def shown(budget: Budget) -> tuple[StringIO, TrainingObserver]:
    """A log, and an observer of a training that is shown in it."""
    log = StringIO()
    progress = Terminal(Console(file=log, width=200))
    return log, TrainingObserver(budget, Stopwatch(), Stopwatch(), dict, progress)


def announced(lines: list[str]) -> list[tuple[int, float | None]]:
    """(units done, seconds left, None while estimating) of every line that says either."""
    found = []
    for line in lines:
        if match := re.search(r"(?:step |: )(\d+).*?(?:(\d+) s left|estimating)", line):
            found.append((int(match[1]), None if match[2] is None else float(match[2])))
    return found


def costs(step: int) -> float:
    """Seconds of a step: the first compiles, the third once more, and a later one."""
    return {1: COLD, 3: 12.0, 400: 9.0}.get(step, STEP)


def check(said: list[tuple[int, float | None]], total: int, within: float = 0.02) -> None:
    assert said and said[0][1] is None, "after one step it is unknown"
    known = [(done, left) for done, left in said if left is not None]
    assert len(known) > 3
    for done, left in known:
        true = sum(costs(step) for step in range(done + 1, total + 1))
        # What a later kernel's compiling will take can't be known.
        assert abs(left - true) <= within * true + 9.5, (done, left, true)


def test_a_cold_start_is_not_extrapolated_by_make_dataset(clock, capsys):
    with Terminal(interval=5.0).stage("reconstruction", STEPS) as advance:
        for step in range(1, STEPS + 1):
            clock.now += costs(step)
            advance(step)
    check(announced(capsys.readouterr().err.splitlines()), STEPS)


def test_a_cold_start_is_not_extrapolated_while_training(clock):
    log, observer = shown(Budget(steps=STEPS))
    seconds = 0.0
    for step in range(1, STEPS + 1):
        clock.now += costs(step)
        seconds += costs(step)
        observer._show(step, 0.1, seconds)
    check(announced(log.getvalue().splitlines()), STEPS)


@pytest.mark.parametrize("steps", [None, 10_000])
def test_a_budget_of_seconds_says_what_is_left(clock, steps):
    log, observer = shown(Budget(seconds=600, steps=steps))
    observer._show(1, 0.1, 80.0)
    for step in range(2, 102):
        observer._show(step, 0.1, 80.0 + step)
    clock.now += 60
    observer._show(102, 0.1, 182.0)
    first, last = log.getvalue().splitlines()
    assert first.endswith("about 520 s left") and last.endswith("about 418 s left")


def test_steps_that_get_slower_are_followed(clock):
    remaining = Remaining(1000)
    for step in range(1, 900):
        clock.now += 0.01 if step < 400 else 0.4
        remaining.told(step, clock.now)
    assert remaining.seconds() == pytest.approx(101 * 0.4, rel=FLOAT64_VALUE)


def test_few_long_units_are_estimated_after_the_second():
    remaining = Remaining(6)
    remaining.told(1, 300.0)
    assert remaining.seconds() is None
    remaining.told(2, 360.0)
    assert remaining.seconds() == pytest.approx(240, rel=FLOAT64_VALUE)
    remaining.told(2, 500.0)  # told twice
    assert remaining.seconds() == pytest.approx(240, rel=FLOAT64_VALUE)


def test_what_an_earlier_run_finished_is_no_measure_of_the_rest():
    """Of 40 views 20 are there, and counted at once; the others take a minute each."""
    remaining = Remaining(40)
    for done in range(1, 21):
        remaining.told(done, 0.001 * done)
    for done in range(21, 28):
        remaining.told(done, 60.0 * (done - 20))
    assert remaining.seconds() == pytest.approx(13 * 60, rel=DIFFERENCE_OF_TIMES)


@given(st.integers(8, 300), st.floats(0.001, 100), st.floats(0, 1e5))
def test_steady_work_is_estimated_exactly_whatever_went_before(total, pace, cold):
    remaining = Remaining(total)
    for done in range(1, total):
        remaining.told(done, cold + pace * done)
        left = remaining.seconds()
        assert left is None or left == pytest.approx(pace * (total - done), rel=DIFFERENCE_OF_TIMES)
    assert left is not None
