"""`dofbench run`: one run here, or a matrix of runs in processes of their own."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from dofbench.errors import InputError
from dofbench.harness.prepare import builtin_dataset
from dofbench.harness.run import run as run_one
from dofbench.harness.settings import Run
from dofbench.processes import run_jobs
from dofbench.runs.batch import Batch
from dofbench.runs.make import RunJobs
from dofbench.runs.planned import PlannedRun, different_datasets, plan_run
from dofbench.runs.settings import Runs
from dofbench.synthesis.dataset import Dataset


def run_all(settings: Runs, console: Console | None = None, run_jobs: RunJobs = run_jobs) -> bool:
    """Make the run that the settings name, or every run of their matrix that isn't finished.

    A run of a matrix is the run that its own command would make, in the same folder. False when one failed. Raises
    InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    if settings.photographs is not None:
        return _run_photographs(settings, settings.photographs, console, run_jobs)
    cells = settings.cells()
    if len(cells) == 1:
        return bool(run_one(cells[0], console))
    if settings.data is None and not builtin_dataset(settings.dry_run, console):
        return True
    runs = plan_matrix(cells)
    batch = Batch(runs, settings.out, settings.jobs, rerun=settings.rerun)
    for line in _plan_lines(settings, batch):
        _say(console, line)
    if settings.dry_run:
        return True
    batch.make(run_jobs=run_jobs)
    failures = batch.failures()
    for line in failures:
        _say(console, line)
    folders = dict.fromkeys(run.folder.parent for run in runs)
    _say(
        console,
        f"{len(runs) - len(failures)} of {len(runs)} runs are done and ok; "
        f"results {', '.join(map(str, folders))}; tables: dofbench report {settings.out}",
    )
    return not failures


def _run_photographs(settings: Runs, source: Path, console: Console, run_jobs: RunJobs) -> bool:
    """Everything from photographs to a page; False when a part of it failed."""
    from dofbench.reporting import report
    from dofbench.reporting.settings import Report
    from dofbench.runs.photographs import check_runs, dataset_of_photographs, find_own, outlook

    cells = settings.cells()
    check_runs(cells)
    own = find_own(source, settings.out)
    for line in outlook(own, cells, settings.width):
        _say(console, line)
    if settings.dry_run:
        return True
    data = dataset_of_photographs(own, settings.width, console)
    if data is None:
        return False
    done = run_all(replace(settings, photographs=None, width=None, data=str(data)), console, run_jobs)
    # What else lies in OUT is no business of a page about these photographs.
    page = report(Report(results=settings.out / Dataset.load(data).name, out=own.place / "report"))
    return done and bool(page)


def plan_matrix(cells: tuple[Run, ...]) -> tuple[PlannedRun, ...]:
    """Decide every run. Raises InputError, which names the run, for what doesn't fit together."""
    different_datasets([folder for folder in dict.fromkeys(cell.data for cell in cells) if folder is not None])
    first: dict[tuple[str, Path | None, str | None, str | None], PlannedRun] = {}
    runs = []
    for cell in cells:
        kind = cell.method, cell.data, cell.preset, cell.budget
        if kind not in first:
            try:
                first[kind] = plan_run(cell)
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
            head, *rest = planned.plan.lines()
            more = f"; seeds {', '.join(map(str, seeds))}" if settings.seeds > 1 else ""
            lines += [head + more, *(f"  {line}" for line in rest)]
    for planned in batch.runs:
        words = batch.ended.words(planned)
        if planned.name in batch.seconds:
            seconds = batch.seconds[planned.name]
            words = "to be run again" if words.startswith("finished") else words
            words += ", time unknown" if seconds is None else f", about {seconds:.0f} s"
        lines.append(f"{words}: {planned.settings.command()}")
    return [*lines, *batch.outlook()]


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, markup=False, soft_wrap=True)
