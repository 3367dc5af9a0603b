"""`dofbench run`: one run in this process, or a matrix of runs in processes of their own."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from rich.console import Console

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.core.jobs import Executor, ThisProcess
from dofbench.core.progress import say
from dofbench.evaluation.results.run_spec import Run
from dofbench.running.batch import Batch, processes_for
from dofbench.running.one_run import show_finished
from dofbench.running.planned_runs import PlannedRun, different_datasets
from dofbench.running.prepare import plan_run
from dofbench.running.run_options import Runs


def run_all(settings: Runs, builtin: Path, console: Console | None = None, executor: Executor | None = None) -> bool:
    """Make the run that the settings name, or every run of their matrix that isn't finished.

    A run of a matrix is the run that its own command would make, in the same folder. builtin: the dataset's folder
    where the settings name none. executor: who makes the runs of a matrix; processes of this machine unless one is
    given. False when one failed. Raises InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    runs = plan_matrix(settings.cells(), builtin)
    alone = len(runs) == 1
    who: Executor = ThisProcess() if alone else executor or processes_for(runs, settings.jobs)
    batch = Batch(runs, settings.out, who, rerun=settings.rerun, console=console if alone else None)
    for line in _plan_lines(settings, batch):
        say(console, line)
    if settings.dry_run:
        return True
    batch.make()
    failures = batch.failures()
    if alone:
        found = batch.ended.find(runs[0])
        if not batch.open and found is not None and found.result is not None:
            show_finished(console, runs[0], found.result)
        return not failures
    for line in failures:
        say(console, line)
    folders = dict.fromkeys(run.folder.parent for run in runs)
    say(
        console,
        f"{len(runs) - len(failures)} of {len(runs)} runs are done and ok; "
        f"results {', '.join(map(str, folders))}; tables: dofbench report {settings.out}",
    )
    return not failures


def plan_matrix(cells: tuple[Run, ...], builtin: Path) -> tuple[PlannedRun, ...]:
    """Decide every run. builtin: as in `run_all`.

    Raises InputError, which names the run, for what doesn't fit together.
    """
    different_datasets([folder for folder in dict.fromkeys(cell.data for cell in cells) if folder is not None])
    first: dict[tuple[str, Path | None, str | None, Budget | None], PlannedRun] = {}
    runs = []
    for cell in cells:
        kind = cell.method, cell.data, cell.preset, cell.budget
        if kind not in first:
            try:
                first[kind] = plan_run(cell, cell.data or builtin)
            except InputError as error:
                where = f"{cell.method} on {cell.data or 'the built-in dataset'}: {error.subject}"
                raise InputError(where, error.found, error.expected) from None
        runs.append(first[kind].with_seed(cell.seed))
    for name, times in Counter(run.name for run in runs).items():
        if times > 1:
            raise InputError("the matrix", f"the run {name} {times} times", "every run once")
    return tuple(runs)


def _plan_lines(settings: Runs, batch: Batch) -> list[str]:
    """What would be done and left out, kind by kind, and every run with what is known of it."""
    lines = []
    for planned in batch.runs:
        if planned.settings.seed == settings.seed:
            seeds = range(settings.seed, settings.seed + settings.seeds)
            head, *rest = planned.lines()
            more = f"; seeds {', '.join(map(str, seeds))}" if settings.seeds > 1 else ""
            lines += [head + more, *(f"  {line}" for line in rest)]
    for planned in batch.runs:
        words = batch.ended.words(planned)
        if planned.name in batch.takes:
            seconds = batch.takes[planned.name].seconds
            words = "to be run again" if words.startswith("finished") else words
            words += ", time unknown" if seconds is None else f", about {seconds:.0f} s"
        lines.append(f"{words}: {planned.settings.command()}")
    return [*lines, *batch.outlook()]
