"""`dofbench run --photographs`: all stages from photographs to the report's page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from dofbench.cli.from_photographs import check_runs, dataset_of_photographs, find_own, outlook
from dofbench.core.jobs import Executor
from dofbench.core.progress import say
from dofbench.datasets.format.dataset import Dataset
from dofbench.reporting import report
from dofbench.reporting.report_options import Report
from dofbench.running.matrix import run_all
from dofbench.running.run_options import Runs


def run_photographs(
    settings: Runs, source: Path, console: Console | None = None, executor: Executor | None = None
) -> bool:
    """Reconstruct the photographs in `source`, make a dataset of them, train on it and write a report.

    False when one of these stages failed. Raises InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    cells = settings.cells()
    check_runs(cells)
    own = find_own(source, settings.out)
    for line in outlook(own, cells, settings.width):
        say(console, line)
    if settings.dry_run:
        return True
    data = dataset_of_photographs(own, settings.width, console)
    if data is None:
        return False
    done = run_all(replace(settings, photographs=None, width=None, data=str(data)), data, console, executor)
    # OUT may hold results of other datasets too; the page is about these photographs alone.
    page = report(Report(results=settings.out / Dataset.load(data).name, out=own.place / "report"))
    return done and bool(page)
