"""The runs of one call: which are finished, what is left to make, and what failed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from dofbench.core.errors import Status
from dofbench.core.jobs import Executor, Outcome, Watcher
from dofbench.core.progress import Several
from dofbench.running.ended_runs import Ended
from dofbench.running.planned_runs import PlannedRun
from dofbench.running.run_jobs import run_job, shown_job
from dofbench.running.time_estimate import expected, finished_results, time_to_go
from dofbench.runtime.devices import count
from dofbench.runtime.processes import LocalProcesses


def processes_for(runs: Sequence[PlannedRun], workers: int) -> LocalProcesses:
    """The executor of this machine; it knows how many GPUs there are where a run asks for any."""
    asked = any(run.spec.device == "cuda" for run in runs)
    return LocalProcesses(workers, gpus=count("cuda") if asked else 0)


class Batch:
    """What a call plans, be it one run, a matrix of runs or tables of runs, and what becomes of it.

    runs: each once. results: where finished ones lie, to estimate the time by. executor: who makes them. rerun: make
    the finished ones again too. console: where a run shows itself, for a call of one run; else lines about all of them
    go to standard error.
    """

    def __init__(
        self,
        runs: Sequence[PlannedRun],
        results: Path,
        executor: Executor,
        *,
        rerun: bool = False,
        console: Console | None = None,
    ):
        self.runs, self.ended = tuple(runs), Ended()
        self.open = tuple(run for run in runs if rerun or not self.ended.finished(run))
        self._executor, self._console = executor, console
        known = finished_results(results) if self.open else []
        self._by = (
            "by the runs that are finished and the budgets"
            if known
            else "by the method's card, for two cores: half or twice that elsewhere; the first run compiles kernels"
        )
        self.takes = {run.name: expected(run, known) for run in self.open}
        self._problems: dict[str, str] = {}

    def outlook(self) -> list[str]:
        """How many runs are finished, and how long the others will take."""
        lines = []
        if len(self.runs) > 1:
            lines.append(f"{len(self.runs)} runs; {len(self.runs) - len(self.open)} of them are finished")
        if self.open:
            lines.append(time_to_go(list(self.takes.values()), self._executor.at_a_time, self._by))
        return lines

    def make(self, after: Callable[[PlannedRun], object] = lambda run: None) -> None:
        """Make what is open; one that fails doesn't stop the others. after: told when one has ended, well or not."""
        if not self.open:
            return
        named = {run.name: run for run in self.open}

        def ended(name: str) -> None:
            self.ended.forget(named[name])  # what an earlier call left there is overwritten
            after(named[name])

        if self._console is not None:
            jobs = [shown_job(run, self.takes[run.name], self._console) for run in self.open]
            watcher: Watcher = _Silent()
        else:
            jobs = [run_job(run, self.takes[run.name]) for run in self.open]
            seconds = {name: takes.seconds for name, takes in self.takes.items() if takes.seconds is not None}
            watcher = Several(len(jobs), self._executor.at_a_time, things="runs", expected=seconds)
        outcomes = self._executor.run(jobs, _Told(watcher, ended))
        self._problems = {outcome.name: outcome.problem for outcome in outcomes if outcome.problem}

    def failures(self) -> list[str]:
        """One line for each run that has no result, or one that isn't ok."""
        lines = []
        for run in self.runs:
            entry = self.ended.find(run)
            if run.name in self._problems or entry is None or entry.status is not Status.OK:
                left = f"{entry.status}: {entry.message}" if entry else "not run"
                how = (self._problems.get(run.name) or left).strip().splitlines()
                lines.append(f"failed: {run.folder}: {how[-1] if how else left}")
        return lines


class _Silent:
    """A watcher of a run that shows itself."""

    def started(self, name: str) -> None:
        """Nothing to show."""

    def reported(self, name: str, report: Any) -> None:
        """Nothing to show."""

    def put_off(self, name: str) -> None:
        """Nothing to show."""

    def ended(self, outcome: Outcome) -> None:
        """Nothing to show."""


class _Told:
    """A watcher, and someone who is told the name of each job that has ended."""

    def __init__(self, watcher: Watcher, ended: Callable[[str], None]):
        self._ended = ended
        self.started, self.reported, self.put_off = watcher.started, watcher.reported, watcher.put_off
        self._show_end = watcher.ended

    def ended(self, outcome: Outcome) -> None:
        """The job ended: show it, then tell."""
        self._show_end(outcome)
        self._ended(outcome.name)
