"""One run, from its options to its result, and the job that makes it in another process."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.file_lock import HeldElsewhere
from dofbench.core.jobs import Busy, Job, Outcome, Report, Resources
from dofbench.core.progress import Progress, Reported, Terminal, say
from dofbench.evaluation.results.result import Result, read_result
from dofbench.evaluation.results.run_lock import at_work
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.running.execution import cached, execute
from dofbench.running.plan import Plan, make_plan


def run(
    spec: RunSpec, console: Console | None = None, progress: Progress | None = None, *, data: Path | str | None = None
) -> Outcome:
    """Train, score and write `<out>/<dataset>/<method>-<preset>-seed<k>-<key>/result.json`.

    A finished result of the same key is reused. A run that fails still writes its result, with a typed status. data:
    the dataset's folder, where `spec` names none: of the built-in one, which must be there. progress: shows the
    training.

    Raises InputError when the call is wrong, and KeyboardInterrupt when it was interrupted (after writing a result that
    says so).
    """
    console = console or Console()
    data = spec.data if data is None else data
    if data is None:
        raise InputError("data", "none", "a dataset's folder: the built-in one is made by the command, or make_dataset")
    plan = make_plan(spec, Path(data))
    for line in plan.lines() if spec.dry_run or spec.verbose else plan.summary():
        say(console, line)
    if spec.dry_run:
        return Outcome(plan.name, folder=plan.folder)
    return execute(plan, console, progress or Terminal(console))


def run_job(plan: Plan, takes: Resources) -> Job:
    """The run as a job that reports its progress, and does the same in any process.

    A run that another process has at work is left to it, so that several commands on one folder share the work. A run
    that fails with a typed status leaves its result, and the job has no problem.
    """
    return Job(
        plan.name, partial(_work, plan), busy=partial(at_work, plan.folder), done=partial(_done, plan), takes=takes
    )


def _work(plan: Plan, report: Report) -> str:
    """Make one run; returns one line about its end. Raises Busy where another process has it at work."""
    try:
        outcome = execute(plan, Console(quiet=True), Reported(report))
    except HeldElsewhere as error:
        raise Busy(str(error)) from None
    return _line(read_result(outcome.folder), reused=outcome.reused)


def _done(plan: Plan) -> str:
    """One line about a run that another process has finished since this one planned it; else ""."""
    result = None if plan.settings.rerun else cached(plan)
    return "" if result is None else _line(result, reused=True)


def _line(result: Result, *, reused: bool) -> str:
    seconds = result.scores.get("train_s")
    trained = f"{result.scores['steps']:.0f} steps" + ("" if seconds is None else f" in {seconds:.0f} s")
    parts = [f"{result.status}, {trained}", *(["by another process"] * reused)]
    return f"{result.spec.folder}: {', '.join(parts)}" + (f": {result.message}" if result.message else "")
