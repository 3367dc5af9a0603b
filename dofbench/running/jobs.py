"""Making the runs: each in a process of its own, several at a time, none twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

from rich.console import Console

from dofbench.core.budget import Budget
from dofbench.core.processes import Job, Outcome, Report, Watcher, run_jobs
from dofbench.results.result import read_result
from dofbench.results.run_lock import is_running
from dofbench.results.run_spec import Run
from dofbench.running.one_run import run
from dofbench.running.planned_runs import PlannedRun

RunJobs = Callable[..., list[Outcome]]
_REPORT_EVERY = 2.0  # seconds


def make_runs(
    runs: Sequence[PlannedRun],
    workers: int,
    watcher: Watcher,
    ended: Callable[[PlannedRun], None],
    run_jobs: RunJobs = run_jobs,
) -> list[Outcome]:
    """Make the runs in their order, `workers` at a time; one that fails doesn't stop the others.

    A run that another command has at work is left for later, and waited for at the end, so that two commands on one
    folder share the work. ended: told after each. Returns the outcomes; a run that failed with a typed status left its
    result, and its outcome has no problem: `problem` is for what left none.
    """
    named = {run.name: run for run in runs}
    jobs = [
        Job(
            name,
            partial(make_run, run.settings, run.data, run.spec.key, run.folder),
            busy=partial(is_running, run.folder),
        )
        for name, run in named.items()
    ]
    return run_jobs(jobs, workers=workers, watcher=_Told(watcher, lambda name: ended(named[name])))


def make_run(settings: Run, data: Path, key: str, folder: Path, report: Report) -> str:
    """One run, in the process that is its own; returns one line about its end.

    data: the dataset's folder. key: the run's, as it was planned. folder: its result's. Raises InputError when the run
    is another one than was planned: code or data changed meanwhile.
    """
    if is_running(folder):
        report(("waiting for another process that has it at work", 0, 0))
    end = run(settings, Console(quiet=True), partial(_Reported, report), data=data, key=key, wait=True)
    result = read_result(end.folder)
    trained = f"{result.scores['steps']:.0f} steps in {result.scores['train_s']:.0f} s"
    parts = [f"{result.status}, {trained}", *(["by another process"] * end.reused)]
    return f"{result.spec.folder}: {', '.join(parts)}" + (f": {result.message}" if result.message else "")


class _Reported:
    """Progress of a training that goes to another process, as (what, done, total)."""

    def __init__(self, report: Report, console: Console, budget: Budget):
        self._report, self._budget, self._last = report, budget, 0.0

    def __enter__(self) -> _Reported:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Nothing to close."""

    def __call__(self, step: int, loss: float, seconds: float) -> None:
        """Told after each step."""
        now = time.monotonic()
        if now - self._last >= _REPORT_EVERY:
            self._last = now
            steps, limit = self._budget.steps, self._budget.seconds
            self._report(("step", step, steps) if steps is not None else ("second", round(seconds), round(limit or 0)))

    def stage(self, name: str, done: int, total: int) -> None:
        """Told of what comes before the first step."""
        now = time.monotonic()
        if done == 0 or now - self._last >= _REPORT_EVERY:
            self._last = now
            self._report((name, done, total))

    def waiting(self, name: str, seconds: float) -> None:
        """Told that something goes on which can't be counted."""
        self._report((f"{name}, {seconds:.0f} s", 0, 0))


class _Told:
    """A watcher, and someone who wants to know what has ended."""

    def __init__(self, watcher: Watcher, ended: Callable[[str], None]):
        self._watcher, self._ended = watcher, ended

    def started(self, name: str) -> None:
        """Passed on."""
        self._watcher.started(name)

    def reported(self, name: str, report: Any) -> None:
        """Passed on."""
        self._watcher.reported(name, report)

    def ended(self, outcome: Outcome) -> None:
        """Passed on, and told."""
        self._watcher.ended(outcome)
        self._ended(outcome.name)
