"""One run, from its settings to its result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from dofbench.core.clock import StageTimes, loading, timestamp
from dofbench.core.errors import InputError, Status
from dofbench.core.progress import say
from dofbench.evaluation.results.result import Result
from dofbench.evaluation.results.run_lease import run_lease
from dofbench.evaluation.results.run_spec import Run
from dofbench.running.execution import IMPORT, TRAINED_FILE, Execution, ProgressBar, kernels_compiled
from dofbench.running.plan import decided
from dofbench.running.planned_runs import PlannedRun
from dofbench.running.prepare import prepare
from dofbench.running.run_progress import TrainingProgress, print_result
from dofbench.runtime.freed_memory import keep_freed_memory


@dataclass(frozen=True)
class RunEnd:
    """How a call of `run` ended. folder: where its result is. status: None for a dry run. reused: whether a finished
    result of the same key was there already. True when nothing failed."""

    folder: Path
    status: Status | None
    reused: bool = False

    def __bool__(self) -> bool:
        return self.status in (None, Status.OK)


def run(
    settings: Run,
    console: Console | None = None,
    progress: ProgressBar = TrainingProgress,
    *,
    data: Path | None = None,
    key: str | None = None,
    wait: bool = False,
) -> RunEnd:
    """Train, score and write `<out>/<dataset>/<method>-<preset>-seed<k>-<key>/result.json`.

    A finished result of the same key is reused. A run that fails still writes its result, with a typed
    status. data: the dataset's folder, where `settings` names none: of the built-in one, which must be there. progress:
    shows the training. key: what the run's must be, where it was planned (and shown) before. wait: for another process
    that has the same run at work.

    Raises InputError when the call is wrong or the key is another one, and KeyboardInterrupt when it was interrupted
    (after writing a result that says so).
    """
    console = console or Console()
    data = settings.data if data is None else data
    if data is None:
        raise InputError("data", "none", "a dataset's folder: the built-in one is made by the command, or make_dataset")
    stages = StageTimes()
    already_compiled = kernels_compiled()
    run = prepare(settings, data)
    planned = run.planned
    stages[IMPORT].move(loading)  # the method's own modules, and all that this process imported before
    if key is None:
        for line in planned.lines():
            say(console, line)
    elif planned.spec.key != key:
        raise InputError(
            planned.folder,
            "code or data that changed since the call began",
            "the same; the same command goes on with the new",
        )
    if settings.dry_run:
        return RunEnd(planned.folder, None)

    keep_freed_memory()
    with run_lease(planned.folder, planned.spec, run.dataset.scene, timestamp(), wait=wait) as lease:
        if not settings.rerun and (earlier := run.finished()) is not None:
            # Of a process that died after its result was written.
            (planned.folder / TRAINED_FILE).unlink(missing_ok=True)
            show_finished(console, planned, earlier)
            return RunEnd(planned.folder, earlier.status, reused=True)
        status = Execution(run, lease, console, progress, stages, already_compiled).go()
        return RunEnd(planned.folder, status)


def show_finished(console: Console, planned: PlannedRun, result: Result) -> None:
    """Show the result of a run that was finished before."""
    say(console, f"the same run is finished already, reusing it (--rerun runs again): {planned.folder}")
    for line in decided(planned.plan.stages, result.plan):
        say(console, line)
    print_result(console, result)
