"""The runs of one call: which are finished, what is left to make, and what failed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from dofbench.core.errors import Status
from dofbench.core.processes import run_jobs
from dofbench.core.progress import Several
from dofbench.running.ended_runs import Ended
from dofbench.running.jobs import RunJobs, make_runs
from dofbench.running.planned_runs import PlannedRun
from dofbench.running.time_estimate import expected_seconds, finished_results, time_to_go


class Batch:
    """runs: each once. results: where finished ones lie, to estimate the time by. workers: runs at a time. rerun: make
    the finished ones again too."""

    def __init__(self, runs: Sequence[PlannedRun], results: Path, workers: int, *, rerun: bool = False):
        self.runs, self.ended = tuple(runs), Ended()
        self.open = tuple(run for run in runs if rerun or not self.ended.finished(run))
        self._workers = max(1, min(workers, len(self.open)))
        known = finished_results(results) if self.open else []
        self.seconds = {run.name: expected_seconds(run, known) for run in self.open}
        self._problems: dict[str, str] = {}

    def outlook(self) -> list[str]:
        """How many runs are finished, and how long the others will take."""
        counted = f"{len(self.runs)} runs; {len(self.runs) - len(self.open)} of them are finished"
        return [counted, *([time_to_go(self.open, list(self.seconds.values()), self._workers)] if self.open else [])]

    def make(self, after: Callable[[PlannedRun], object] = lambda run: None, run_jobs: RunJobs = run_jobs) -> None:
        """Make what is open; one that fails doesn't stop the others. after: told when one has ended, well or not."""
        if not self.open:
            return

        def ended(run: PlannedRun) -> None:
            self.ended.forget(run)  # what an earlier call left there is overwritten
            after(run)

        known = [one for one in self.seconds.values() if one is not None]
        watcher = Several(
            len(self.open), self._workers, things="runs", expected=sum(known) / len(known) if known else None
        )
        outcomes = make_runs(self.open, self._workers, watcher, ended, run_jobs)
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
