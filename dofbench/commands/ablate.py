"""`dofbench ablate`: plan, run what isn't finished, write the tables as the runs end."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from dofbench.core.files import write_text
from dofbench.core.processes import run_jobs
from dofbench.reporting.ablations.ablation_page import table_page
from dofbench.reporting.ablations.cells import fill
from dofbench.reporting.ablations.csv_files import write_cells, write_summary
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_plan import Plan, make_plan
from dofbench.running.ablation_tables import read_tables, shipped_file
from dofbench.running.batch import Batch
from dofbench.running.ended_runs import Ended
from dofbench.running.jobs import RunJobs


def make_tables(settings: Ablate, console: Console | None = None, run_jobs: RunJobs = run_jobs) -> bool:
    """Make every run that isn't finished, and write `<out>/<table>.md`, `.csv` and `-summary.csv` for each table.

    The tables are written anew after every run, so that what there is can be read while the rest is at work.
    False when a run failed. Raises InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    plan = make_plan(settings, read_tables(settings.tables or shipped_file()))
    batch = Batch(plan.runs, settings.results, settings.jobs)
    cells = sum(len(one.runs) for one in plan.tables)
    counted, *outlook = batch.outlook()
    for line in (*plan.skipped, f"{len(plan.tables)} tables with {cells} cells, which take {counted}", *outlook):
        _say(console, line)
    if settings.dry_run:
        for run in plan.runs:
            rows = dict.fromkeys(
                f"{one.table.id} {place[0]}"
                for one in plan.tables
                for place, needed in one.runs.items()
                if needed is run
            )
            _say(console, f"{batch.ended.words(run)}, for {'; '.join(rows)}: {run.settings.command()}")
        return True

    batch.make(lambda run: _write(settings, plan, batch.ended), run_jobs)
    for file in _write(settings, plan, batch.ended):
        _say(console, f"wrote {file}")
    failures = batch.failures()
    for line in failures:
        _say(console, line)
    return not failures


def _write(settings: Ablate, plan: Plan, ended: Ended) -> list[Path]:
    files = []
    for table_plan in plan.tables:
        filled = fill(table_plan, ended)
        page, cells, summary = (settings.out / f"{table_plan.table.id}{end}" for end in (".md", ".csv", "-summary.csv"))
        write_text(page, table_page(filled, settings))
        write_cells(cells, filled)
        write_summary(summary, filled)
        files += [page, cells, summary]
    return files


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, markup=False, soft_wrap=True)
