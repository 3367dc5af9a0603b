"""`dofbench ablate`: plan, run what isn't finished, write the tables as the runs end."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from dofbench.core.files import write_csv, write_text
from dofbench.core.jobs import Executor
from dofbench.core.progress import say
from dofbench.reporting.ablation import ablation_page, write_document
from dofbench.reporting.render import markdown
from dofbench.running.ablation_options import Ablate
from dofbench.running.ablation_plan import AblationPlan, plan_tables
from dofbench.running.ablation_scores import CELL_COLUMNS, SUMMARY_COLUMNS, cell_rows, fill, summary_rows
from dofbench.running.ablation_tables import read_tables, tables_of
from dofbench.running.batch import Batch, executor_for
from dofbench.running.ended_runs import Ended


def make_tables(settings: Ablate, console: Console | None = None, executor: Executor | None = None) -> bool:
    """Make every run that isn't finished, and write `<out>/<table>.md`, `.json`, `.csv` and `-summary.csv` for each
    table: the page, the page as data for `dofbench report --ablation`, every run's scores, and their means.

    The tables are rewritten after every run, so that finished scores can be read while other runs are in progress.
    executor: carries out the runs; by default processes of this machine. False when a run failed. Raises
    InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    plan = plan_tables(settings, read_tables(settings.tables or tables_of(settings.method)))
    batch = Batch(plan.runs, settings.results, executor or executor_for(plan.runs, settings, settings.results))
    cells = sum(len(one.runs) for one in plan.tables)
    tables = f"{len(plan.tables)} table{'s' * (len(plan.tables) != 1)} with {cells} cells"
    for line in (*plan.skipped, tables, *batch.outlook()):
        say(console, line)
    if settings.dry_run:
        for run in plan.runs:
            rows = dict.fromkeys(
                f"{one.table.id} {place[0]}"
                for one in plan.tables
                for place, needed in one.runs.items()
                if needed is run
            )
            say(console, f"{batch.ended.words(run)}, for {'; '.join(rows)}: {run.settings.command()}")
        return True

    batch.make(lambda run: _write(settings, plan, batch.ended))
    for file in _write(settings, plan, batch.ended):
        say(console, f"wrote {file}")
    failures = batch.failures()
    for line in failures:
        say(console, line)
    return not failures


def _write(settings: Ablate, plan: AblationPlan, ended: Ended) -> list[Path]:
    files = []
    for table_plan in plan.tables:
        filled = fill(table_plan, ended)
        page = ablation_page(filled, settings)
        written = [settings.out / f"{page.id}{suffix}" for suffix in (".md", ".csv", "-summary.csv")]
        write_text(written[0], markdown("ablation", page=page))
        write_csv(written[1], CELL_COLUMNS, cell_rows(filled))
        write_csv(written[2], SUMMARY_COLUMNS, summary_rows(filled))
        files += [written[0], write_document(settings.out, page), *written[1:]]
    return files
