"""Progress of a training: no long silence, and estimates of the time left that are right."""

from __future__ import annotations

import io
import itertools
import re
import threading
import time

import pytest
from rich.console import Console
from small_dataset import write_dataset
from tolerances import LATEST_PACE, WHOLE_SECONDS

from dofbench.core.budget import Budget
from dofbench.core.clock import Stopwatch
from dofbench.core.progress import INTERVAL, Progress, Terminal
from dofbench.running.observer import TrainingObserver

VIEWS = tuple(f"v{index}" for index in range(6))


class Log:
    """A log file with a clock: notes when each line was written."""

    def __init__(self, budget: Budget, *, terminal: bool = False):
        self.now, self.lines = 0.0, []
        self._file = io.StringIO()
        self.console = Console(file=self._file, force_terminal=terminal, width=200)
        self.progress = Terminal(self.console)
        self._observer = TrainingObserver(budget, Stopwatch(), Stopwatch(), dict, self.progress)

    def text(self) -> str:
        return self._file.getvalue()

    def take(self) -> None:
        """Note new lines at the present time."""
        new = self.text().splitlines()[len(self.lines) :]
        self.lines += [(self.now, line) for line in new]

    def stage(self, name: str, done: int, total: int) -> None:
        self.progress.update(name, done, total)
        self.take()

    def step(self, step: int, seconds: float) -> None:
        self._observer._show(step, 0.5, seconds)
        self.take()


@pytest.fixture
def log(monkeypatch):
    """Makes a log whose clock is the program's."""

    def make(budget: Budget, **given) -> Log:
        made = Log(budget, **given)
        monkeypatch.setattr(time, "monotonic", lambda: made.now)
        return made

    return make


def seconds_left(line: str) -> float | None:
    found = re.search(r"about (\d+) s left", line)
    return float(found[1]) if found else None


@pytest.mark.parametrize("a_view", [0.5, 6.0, 25.0])
def test_a_prior_is_never_silent_for_longer_than_a_view(log, a_view):
    """54 views, the first of them five times as slow: a line at the least every ten seconds and one view."""
    log, views = log(Budget(steps=100)), 54
    log.stage("sweep", 0, views)
    assert log.lines == [(0.0, f"sweep: 0 of {views}")]
    for view in range(1, views + 1):
        log.now += 5 * a_view if view == 1 else a_view
        log.stage("sweep", view, views)
    times = [when for when, _ in log.lines]
    gaps = [later - before for before, later in itertools.pairwise(times)]
    assert max(gaps) <= max(5 * a_view, INTERVAL + a_view)
    assert log.lines[-1][1].startswith(f"sweep: {views} of {views}, ")
    for when, line in log.lines:
        left = seconds_left(line)
        if left is not None:
            assert left == pytest.approx(log.now - when, abs=WHOLE_SECONDS)
    # At the beginning there is no telling: of a handful of views and the slow first one, and of the first line.
    unsure = [when for when, line in log.lines[1:-1] if seconds_left(line) is None]
    assert all(when <= (5 + 5) * a_view for when in unsure) and len(unsure) < len(log.lines) - 2


def test_the_time_left_of_training_knows_nothing_of_the_prior(log):
    """A prior of 386 s, then 3000 steps of 0.2 s: about 600 s left, not weeks."""
    log = log(Budget(steps=3000))
    log.stage("sweep", 0, 2)
    log.now = 386.0
    log.stage("sweep", 2, 2)
    for step in range(1, 401):
        log.now += 30.0 if step == 1 else 0.2  # and the first step does what others needn't
        log.step(step, log.now)
    said = [(when, seconds_left(line)) for when, line in log.lines if line.startswith("training: ")]
    assert said[0][1] is None
    end = 386 + 30 + 0.2 * 2999
    assert len(said) > 3
    for when, left in said[1:]:
        assert left == pytest.approx(end - when, abs=2 * WHOLE_SECONDS)


def test_training_that_slows_down_is_noticed(log):
    """Coarse steps of 0.05 s, then full ones of 0.5 s: soon the estimate follows the latest."""
    log = log(Budget(steps=2000))
    for step in range(1, 1001):
        log.now += 0.05 if step <= 500 else 0.5
        log.step(step, log.now)
    when, last = log.lines[-1]
    assert seconds_left(last) == pytest.approx(0.05 * 500 + 0.5 * 1500 - when, rel=LATEST_PACE)


def test_a_budget_of_seconds_is_what_is_left_of_it(log):
    log = log(Budget(seconds=500.0))
    log.now = 386.0
    log.step(1, 386.0)
    assert seconds_left(log.lines[-1][1]) == 114


def test_on_a_terminal_the_bar_names_the_stage(log):
    log = log(Budget(steps=10), terminal=True)
    with log.progress.stage("sweep", 9) as advance:
        for view in range(1, 5):
            log.now += 3
            advance(view)
    assert "sweep" in log.text() and "4 of 9" in log.text() and "about 15 s left" in log.text()


def test_the_observer_passes_stages_on_with_its_clock_stopped():
    told, clock = [], Stopwatch()

    class Told(Progress):
        def update(self, *given):
            told.append((*given, clock._since is None))

    observer = TrainingObserver(Budget(steps=2), clock, Stopwatch(), dict, Told())
    with clock.running():
        observer.stage("sweep", 1, 3)
    assert told == [("sweep", 1, 3, True)]


def test_what_counts_nothing_is_not_silent_either(log):
    log = log(Budget(steps=1))
    told = threading.Event()

    class Told(Terminal):
        def update(self, *given):
            super().update(*given)
            if len(given) > 3:
                told.set()

    with Told(log.console, interval=0).uncounted("JIT compilation", every=0.01):
        assert log.text() == "JIT compilation\n" and told.wait(10)
    assert log.text().startswith("JIT compilation\nJIT compilation: 0 s\n")
    before = log.text()
    time.sleep(0.05)
    assert log.text() == before  # no more progress is written after the end


@pytest.mark.parametrize(
    ("dataset", "stage", "pictures"),
    [
        ({}, "score", 2 * (2 + 1 + 1)),  # both kinds, depth, and what the photographs resolve, of two views
        ({"test": 0, "train": 4}, None, 0),
        ({"unknown": VIEWS, "blurred": VIEWS, "flat": VIEWS, "exact": False}, "predict photographs", 2),
    ],
    ids=["known lenses", "no test views", "photographs"],
)
def test_every_picture_that_is_scored_is_told(call, tmp_path, monkeypatch, dataset, stage, pictures):
    told: list[tuple[str, int, int]] = []
    monkeypatch.setattr(Terminal, "update", lambda self, *given: told.append(given))
    assert call(data=write_dataset(tmp_path / "data", **dataset))
    if stage is None:
        assert {one[0] for one in told} == {"JIT compilation and warm-up", "training"}
    else:
        assert [one for one in told if one[0] == stage] == [(stage, done, pictures) for done in range(pictures + 1)]
