"""The runs of one call: cached, open and failed ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from dofbench.core.errors import Status
from dofbench.core.jobs import Executor, Outcome
from dofbench.core.progress import Several
from dofbench.evaluation.results.run_spec import SeveralOptions
from dofbench.running.ended_runs import Ended
from dofbench.running.one_run import run_job
from dofbench.running.plan import Plan
from dofbench.running.time_estimate import expected, finished_results, time_to_go
from dofbench.runtime.devices import count
from dofbench.runtime.executors import executor
from dofbench.runtime.processes import LocalProcesses


def executor_for(runs: Sequence[Plan], settings: SeveralOptions, folder: Path) -> Executor:
    """The executor that the settings name; that of this machine knows how many GPUs there are where a run asks for any.
    folder: of the results."""

    def here() -> LocalProcesses:
        gpus = count("cuda") if any(run.spec.device == "cuda" for run in runs) else 0
        return LocalProcesses(settings.jobs or max(1, gpus), gpus=gpus)

    return executor(settings, folder, here)


class Batch:
    """The runs of one call, a matrix or tables, and how they ended.

    runs: each once. results: folder of finished ones, for the estimate of time. rerun: make the finished ones again.
    """

    def __init__(
        self,
        runs: Sequence[Plan],
        results: Path,
        executor: Executor,
        *,
        rerun: bool = False,
    ):
        self.runs, self.ended = tuple(runs), Ended()
        self.open = tuple(run for run in runs if rerun or not self.ended.finished(run))
        self._executor = executor
        known = finished_results(results) if self.open else []
        self._by = (
            "by finished runs"
            if known
            else "for two cores: half or twice that elsewhere; the first run compiles kernels"
        )
        self.takes = {run.name: expected(run, known) for run in self.open}
        self._problems: dict[str, str] = {}

    def outlook(self) -> list[str]:
        """How many runs are finished, and how long the others will take."""
        lines = []
        if len(self.runs) > 1:
            lines.append(f"{len(self.runs)} runs, {len(self.runs) - len(self.open)} of them cached")
        if self.open:
            lines.append(time_to_go(list(self.takes.values()), self._executor.at_a_time, self._by))
        return lines

    def make(self, after: Callable[[Plan], object] = lambda run: None) -> None:
        """Make what is open; one that fails doesn't stop the others. after: told when one has ended, well or not."""
        if not self.open:
            return
        named = {run.name: run for run in self.open}

        def ended(outcome: Outcome) -> None:
            self.ended.forget(named[outcome.name])  # a result of an earlier call is overwritten
            after(named[outcome.name])

        jobs = [run_job(run, self.takes[run.name]) for run in self.open]
        seconds = {name: takes.seconds for name, takes in self.takes.items() if takes.seconds is not None}
        watcher = Several(len(jobs), self._executor.at_a_time, things="runs", expected=seconds, after=ended)
        outcomes = self._executor.run(jobs, watcher)
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
