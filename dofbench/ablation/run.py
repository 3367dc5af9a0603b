"""Making the runs: each in a process of its own, several at a time, none twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from types import TracebackType
from typing import Any

from rich.console import Console

from dofbench.ablation.plan import PlannedRun
from dofbench.contracts import Budget
from dofbench.errors import InputError
from dofbench.harness.prepare import choose, prepare
from dofbench.harness.result import read_result
from dofbench.harness.run import run
from dofbench.harness.settings import Run
from dofbench.processes import Job, Outcome, Report, Watcher, run_jobs

RunJobs = Callable[..., list[Outcome]]
_REPORT_EVERY = 2.0  # seconds


def make_runs(
    runs: Sequence[PlannedRun], workers: int, watcher: Watcher, ended: Callable[[PlannedRun], None],
    run_jobs: RunJobs = run_jobs,
) -> list[Outcome]:
    """Make the runs in their order, `workers` at a time; one that fails doesn't stop the others.

    ended: told after each. Returns the outcomes; a run that failed with a typed status left its result, and its
    outcome has no problem: `problem` is for what left none.
    """
    named = {run.name: run for run in runs}
    jobs = [Job(name, partial(make_run, run.settings, run.spec.key)) for name, run in named.items()]
    return run_jobs(jobs, workers=workers, watcher=_Told(watcher, lambda name: ended(named[name])))


def make_run(settings: Run, key: str, report: Report) -> str:
    """One run, in the process that is its own; returns one line about its end.

    Raises InputError when the run is another one than was planned: code or data changed meanwhile.
    """
    assert settings.data is not None
    prepared = prepare(settings, choose(settings), settings.data)
    if prepared.spec.key != key:
        raise InputError(prepared.folder, "code or data that changed since the call began",
                         "the same; the same command goes on with the new")
    end = run(settings, Console(quiet=True), partial(_Reported, report))
    result = read_result(end.folder)
    trained = f"{result.scores['steps']:.0f} steps in {result.scores['train_s']:.0f} s"
    return f"{prepared.spec.folder}: {result.status}, {trained}" + (f": {result.message}" if result.message else "")


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
