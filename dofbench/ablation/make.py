"""`dofbench ablate`: plan, run what isn't finished, write the tables as the runs end."""

from __future__ import annotations

import statistics
from pathlib import Path

from rich.console import Console

from dofbench.ablation.cells import Ended, fill
from dofbench.ablation.files import write_cells, write_summary
from dofbench.ablation.page import table_page
from dofbench.ablation.plan import Plan, PlannedRun, make_plan
from dofbench.ablation.run import RunJobs, make_runs
from dofbench.ablation.settings import Ablate
from dofbench.ablation.tables import read_tables, shipped_file
from dofbench.errors import InputError, Status
from dofbench.files import write_text
from dofbench.harness.result import RESULT_FILE, Result, read_result
from dofbench.harness.settings import parse_budget
from dofbench.processes import run_jobs
from dofbench.synthesis.progress import Several


def make_tables(settings: Ablate, console: Console | None = None, run_jobs: RunJobs = run_jobs) -> bool:
    """Make every run that isn't finished, and write `<out>/<table>.md`, `.csv` and `-summary.csv` for each table.

    The tables are written anew after every run, so that what there is can be read while the rest is at work.
    False when a run failed. Raises InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    plan = make_plan(settings, read_tables(settings.tables or shipped_file()))
    ended = Ended()
    finished = [run for run in plan.runs if _finished(ended, run)]
    open_runs = [run for run in plan.runs if run not in finished]
    seconds = _seconds_each(settings.results, open_runs)
    for line in (*plan.skipped, *_summary(settings, plan, open_runs, seconds)):
        _say(console, line)
    if settings.dry_run:
        for run in plan.runs:
            rows = dict.fromkeys(f"{one.table.id} {place[0]}" for one in plan.tables
                                 for place, needed in one.runs.items() if needed is run)
            _say(console, f"{'finished' if run in finished else 'to be run'}, for {'; '.join(rows)}: "
                          f"{run.settings.command()}")
        return True

    def after(run: PlannedRun) -> None:
        ended.forget(run)  # what an earlier call left there is overwritten
        _write(settings, plan, ended)

    problems: dict[str, str] = {}
    if open_runs:
        watcher = Several(len(open_runs), min(settings.jobs, len(open_runs)), things="runs", expected=seconds)
        outcomes = make_runs(open_runs, settings.jobs, watcher, after, run_jobs)
        problems = {outcome.name: outcome.problem for outcome in outcomes if outcome.problem}
    for file in _write(settings, plan, ended):
        _say(console, f"wrote {file}")
    failed = [run for run in plan.runs if (entry := ended.find(run)) is None or entry.status is not Status.OK]
    for run in failed:
        entry = ended.find(run)
        how = problems.get(run.name) or (f"{entry.status}: {entry.message}" if entry else "not run")
        _say(console, f"failed: {run.folder}: {how.splitlines()[-1]}")
    return not failed


def _finished(ended: Ended, run: PlannedRun) -> bool:
    entry = ended.find(run)
    return entry is not None and entry.result is not None and entry.result.finished


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


def _summary(settings: Ablate, plan: Plan, open_runs: list[PlannedRun], seconds: float | None) -> list[str]:
    cells = sum(len(one.runs) for one in plan.tables)
    lines = [f"{len(plan.tables)} tables with {cells} cells, which take {len(plan.runs)} runs; "
             f"{len(plan.runs) - len(open_runs)} of them are finished"]
    if open_runs:
        workers = min(settings.jobs, len(open_runs))
        lines.append("no finished run of this kind to estimate the time from" if seconds is None else
                     f"about {seconds * len(open_runs) / workers / 60:.0f} min to go, {workers} runs at a time, by the "
                     "runs that are finished")
    return lines


def _seconds_each(results: Path, open_runs: list[PlannedRun]) -> float | None:
    """Wall seconds of one run, the median over finished runs on the same datasets, scaled by the steps; None where
    there is nothing to go by."""
    if not open_runs or not results.is_dir():
        return None
    wanted = {run.spec.dataset_checksum for run in open_runs}
    steps = statistics.mean(parse_budget(run.spec.budget).steps or 0 for run in open_runs)
    known = []
    for file in sorted(results.rglob(RESULT_FILE)):
        try:
            result = read_result(file)
        except InputError:  # the tables and `dofbench report` name it
            continue
        if result.spec.dataset_checksum in wanted and result.status is Status.OK:
            known.append(_wall(result) * (steps / result.scores["steps"] if steps else 1.0))
    return statistics.median(known) if known else None


def _wall(result: Result) -> float:
    return sum(stage.wall for stage in result.stages.values())


def _say(console: Console, line: str) -> None:
    console.print(line, highlight=False, markup=False, soft_wrap=True)
