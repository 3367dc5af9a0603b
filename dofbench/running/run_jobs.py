"""Runs as jobs: what an executor is given, and how a run in another process says what it does."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from types import TracebackType

from rich.console import Console

from dofbench.core.budget import Budget
from dofbench.core.jobs import FREED, Busy, Job, Report, Resources
from dofbench.evaluation.results.result import read_result
from dofbench.evaluation.results.run_spec import Run
from dofbench.running.one_run import run
from dofbench.running.planned_runs import PlannedRun
from dofbench.runtime.leases import HeldElsewhere, at_work

_REPORT_EVERY = 2.0  # seconds


def run_job(planned: PlannedRun, takes: Resources) -> Job:
    """The run as a job that reports what it does, and does the same wherever it is done.

    A run that another process has at work is left for later, and waited for at the end, so that several commands on one
    folder share the work, also where they begin it at one moment. A run that fails with a typed status leaves its
    result, and the job has no problem: a `problem` is what left none.
    """
    make = partial(make_run, planned.settings, planned.data, planned.spec.key, planned.folder)
    return Job(
        planned.name,
        partial(make, wait=False),
        busy=partial(at_work, planned.folder),
        takes=takes,
        insist=partial(make, wait=True),
    )


def shown_job(planned: PlannedRun, takes: Resources, console: Console) -> Job:
    """The run as a job that shows itself on `console`, for a call of one run in this process: it reports nothing."""
    return Job(planned.name, partial(_show_run, planned, console), takes=takes)


def make_run(settings: Run, data: Path, key: str, folder: Path, report: Report, *, wait: bool) -> str:
    """Make one run; returns one line about its end.

    data: the dataset's folder. key: the run's, as it was planned. folder: its result's. wait: for another process that
    has it at work; else Busy is raised. Raises InputError when the run is another one than was planned: code or data
    changed meanwhile.
    """
    if wait and at_work(folder):
        report(("waiting for another process that has it at work", 0, 0))
    try:
        end = run(settings, Console(quiet=True), partial(_Reported, report), data=data, key=key, wait=wait)
    except HeldElsewhere as error:
        raise Busy(str(error)) from None
    result = read_result(end.folder)
    trained = f"{result.scores['steps']:.0f} steps in {result.scores['train_s']:.0f} s"
    parts = [f"{result.status}, {trained}", *(["by another process"] * end.reused)]
    return f"{result.spec.folder}: {', '.join(parts)}" + (f": {result.message}" if result.message else "")


def _show_run(planned: PlannedRun, console: Console, report: Report) -> str:
    run(planned.settings, console, data=planned.data, key=planned.spec.key)
    return ""


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

    def trained(self) -> None:
        """Told that training is over: another run may train on the accelerator, while this one is scored."""
        self._report(FREED)
