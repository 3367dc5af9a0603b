"""`dofbench run`: make the dataset where there is none yet, then train and score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from dofbench.cli.from_photographs import check_runs, dataset_of_photographs, find_own, outlook
from dofbench.core.errors import Status
from dofbench.core.jobs import Executor
from dofbench.core.progress import Terminal, say
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.format.schema import MANIFEST
from dofbench.datasets.synthesis import builtin_folder, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.collecting import collect
from dofbench.running.compiling import start_compiling
from dofbench.running.convergence import converge_all
from dofbench.running.load_run import LoadedRun, load_run
from dofbench.running.matrix import run_all
from dofbench.running.plan import choose
from dofbench.running.run_options import Runs


def run_methods(settings: Runs, console: Console | None = None, executor: Executor | None = None) -> bool:
    """Carry out the runs that the settings name; False when a run failed.

    Raises InputError when the call is wrong, before anything is made or run.
    """
    console = console or Console()
    if settings.photographs is not None:
        return _run_photographs(settings, settings.photographs, console, executor)
    if settings.data is None and not (builtin_folder() / MANIFEST).is_file():
        for cell in settings.cells():
            choose(cell).check_options()  # a wrong call ends here, not after the dataset was made
        if settings.dry_run:
            say(console, f"would first make the built-in dataset in {builtin_folder()}; the plan depends on it")
            return True
        say(console, f"making the built-in dataset in {builtin_folder()}")
        _start_compiling(settings)
        make_dataset(MakeDataset(out=builtin_folder()))
    make = converge_all if settings.converge else run_all
    return make(settings, builtin_folder(), console, executor)


def _run_photographs(settings: Runs, source: Path, console: Console, executor: Executor | None) -> bool:
    """Reconstruct the photographs in `source`, make a dataset of them, train on it and write a report.

    False when one of these stages failed. Raises InputError when the call is wrong, before anything runs.
    """
    from dofbench.reporting import report
    from dofbench.reporting.report_options import Report
    from dofbench.viewing.own_page import own_page

    cells = settings.cells()
    check_runs(cells)
    own = find_own(source, settings.out)
    expected = outlook(own, cells, settings.width)
    for line in expected if settings.dry_run or settings.verbose else expected[-1:]:
        say(console, line)
    if settings.dry_run:
        return True
    _start_compiling(settings)
    data = dataset_of_photographs(own, settings.width, console)
    if data is None:
        return False
    done = run_all(replace(settings, photographs=None, width=None, data=str(data)), data, console, executor)
    # OUT may hold results of other datasets too; the page is about these photographs alone.
    results = settings.out / Dataset.load(data).name
    page = report(Report(results=results, out=own.place / "report"))
    if (run := _first_good_run(results, [cell.method for cell in cells])) is not None:
        shown = own_page(run, own.place / "page", own.place / "report" / "report.html", Terminal())
        say(console, f"page, film and model: {shown}")
    return done and bool(page)


def _start_compiling(settings: Runs) -> None:
    """While the dataset is made, compile what the run will need; runs of a matrix have processes of their own."""
    cells = settings.cells()
    if len(cells) == 1 and settings.on == "here":
        chosen = choose(cells[0])
        start_compiling(chosen.entry, chosen.device)


def _first_good_run(results: Path, methods: Sequence[str]) -> LoadedRun | None:
    """Of the methods in this order the first with a finished run and its model; None without any."""
    entries = [entry for entry in collect(results).entries if entry.status is Status.OK and entry.result is not None]
    for method in methods:
        for entry in entries:
            run = load_run(entry.folder)
            if entry.spec.method == method and not run.no_model():
                return run
    return None
