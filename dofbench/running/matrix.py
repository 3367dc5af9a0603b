"""`dofbench run`: one run in this process, or a matrix of runs in processes of their own."""

from __future__ import annotations

import shlex
import statistics
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError
from dofbench.core.jobs import Executor
from dofbench.core.progress import Terminal, say
from dofbench.evaluation.comparing.design import undecided
from dofbench.evaluation.results.run_spec import RunSpec
from dofbench.running.batch import Batch, executor_for
from dofbench.running.execution import cached, execute
from dofbench.running.plan import Plan, different_datasets, make_plan
from dofbench.running.run_options import Runs
from dofbench.running.show_result import show_cached

# The scores of a matrix's table, as far as any run has them.
_SHOWN = ("psnr", "aif_psnr", "photo_psnr", "delta_r", "held_out_psnr", "train_s")


def run_all(settings: Runs, builtin: Path, console: Console | None = None, executor: Executor | None = None) -> bool:
    """Make the run that the settings name, or every run of their matrix that isn't finished.

    A run of a matrix is the run that its own command would make, in the same folder. builtin: the dataset's folder
    where the settings name none. executor: makes the runs of a matrix; processes of this machine by default. False when
    one failed. Raises InputError when the call is wrong, before anything runs.
    """
    console = console or Console()
    runs = plan_matrix(settings.cells(), builtin)
    batch = Batch(runs, settings.out, executor or executor_for(runs, settings, settings.out), rerun=settings.rerun)
    for line in all_lines(settings, batch) if settings.dry_run or settings.verbose else summary(batch):
        say(console, line)
    if settings.dry_run:
        return True
    if len(runs) == 1 and settings.on == "here":
        (plan,) = runs
        if not settings.rerun and (earlier := cached(plan)) is not None:
            show_cached(console, plan, earlier)
            return not batch.failures()
        return bool(execute(plan, console, Terminal(console)))
    batch.make()
    failures = batch.failures()
    print_table(console, batch)
    for line in failures:
        say(console, line)
    folders = ", ".join(dict.fromkeys(str(run.folder.parent) for run in runs))
    ok = f"{len(runs) - len(failures)} of {len(runs)} runs ok"
    say(console, f"{ok} in {folders}; report: dofbench report {settings.out}")
    if settings.log is not None:
        say(console, f"log    tensorboard --logdir {shlex.quote(str(settings.out))}")
    return not failures


def plan_matrix(cells: tuple[RunSpec, ...], builtin: Path) -> tuple[Plan, ...]:
    """Plan every run. builtin: as in `run_all`.

    Raises InputError, which names the run, for what doesn't fit together.
    """
    different_datasets([folder for folder in dict.fromkeys(cell.data for cell in cells) if folder is not None])
    first: dict[tuple[str, Path | None, str | None, Budget | None], Plan] = {}
    runs = []
    for cell in cells:
        kind = cell.method, cell.data, cell.preset, cell.budget
        if kind not in first:
            try:
                first[kind] = make_plan(cell, cell.data or builtin)
            except InputError as error:
                where = f"{cell.method} on {cell.data or 'the built-in dataset'}: {error.subject}"
                raise InputError(where, error.found, error.expected) from None
        runs.append(first[kind].with_seed(cell.seed))
    for name, times in Counter(run.name for run in runs).items():
        if times > 1:
            raise InputError("the matrix", f"the run {name} {times} times", "every run once")
    return tuple(runs)


def summary(batch: Batch) -> list[str]:
    """The plan in at most five lines: methods, datasets, budget, estimate, output."""
    plans = batch.runs
    if len(plans) == 1:
        *lines, output = plans[0].summary()
        return [*lines, *(f"time     {line}" for line in batch.outlook()), output]

    def listed(words: Sequence[object]) -> str:
        return ", ".join(dict.fromkeys(map(str, words)))

    methods = [f"{plan.spec.method} ({plan.spec.preset})" for plan in plans]
    return [
        f"methods  {listed(methods)}, seeds {listed([plan.spec.seed for plan in plans])}, on {plans[0].spec.device}",
        f"datasets {listed([plan.spec.dataset for plan in plans])}{_design(plans)}",
        f"budget   {listed([plan.budget for plan in plans])}",
        f"time     {'; '.join(batch.outlook())}",
        f"output   {listed([plan.folder.parent for plan in plans])}",
    ]


def _design(plans: Sequence[Plan]) -> str:
    """What the report won't be able to decide about several methods, before anything runs."""
    if len({(plan.spec.method, plan.spec.preset, plan.spec.budget) for plan in plans}) == 1:
        return ""
    found = []
    for protocol in dict.fromkeys(plan.spec.protocol for plan in plans):  # scenes of one protocol are averaged
        views = {
            plan.spec.dataset_checksum: plan.by_data.test_views for plan in plans if plan.spec.protocol == protocol
        }
        found.append(undecided(sum(views.values()), len(views)))
    return "".join(f"; {nothing}" for nothing in dict.fromkeys(found) if nothing)


def all_lines(settings: Runs, batch: Batch) -> list[str]:
    """All decisions, once for each kind of run, and every run with its state and estimate."""
    lines = []
    for plan in batch.runs:
        if plan.settings.seed == settings.seed:
            seeds = range(settings.seed, settings.seed + settings.seeds)
            head, *rest = plan.lines()
            more = f"; seeds {', '.join(map(str, seeds))}" if settings.seeds > 1 else ""
            lines += [head + more, *(f"  {line}" for line in rest)]
    for plan in batch.runs:
        words = batch.ended.words(plan)
        if plan.name in batch.takes:
            seconds = batch.takes[plan.name].seconds
            words = "to be run again" if words.startswith("cached") else words
            words += ", time unknown" if seconds is None else f", about {seconds:.0f} s"
        lines.append(f"{words}: {plan.settings.command()}")
    design = [design.removeprefix("; ")] if (design := _design(batch.runs)) else []
    return [*lines, *design, *batch.outlook()]


def print_table(console: Console, batch: Batch) -> None:
    """Print the scores of a matrix: a row for each dataset, method, preset and budget, means over seeds."""
    rows: dict[tuple[str, ...], list[dict[str, float]]] = {}
    for plan in batch.runs:
        entry, spec = batch.ended.find(plan), plan.spec
        scores = entry.scores if entry is not None and entry.status == "ok" else {}
        rows.setdefault((spec.dataset, spec.method, spec.preset, spec.budget), []).append(scores)
    columns = [column for column in _SHOWN if any(column in one for found in rows.values() for one in found)]
    varying = [place for place in range(4) if place == 1 or len({names[place] for names in rows}) > 1]
    table = Table(*(("dataset", "method", "preset", "budget")[place] for place in varying), "runs ok")
    for column in columns:
        table.add_column(column, justify="right")
    for names, found in rows.items():
        ok = [one for one in found if one]
        values = [_mean([one[column] for one in ok if column in one]) for column in columns]
        table.add_row(*(names[place] for place in varying), f"{len(ok)} of {len(found)}", *values)
    console.print(table)


def _mean(values: Sequence[float]) -> str:
    if not values:
        return ""
    spread = f" ± {statistics.stdev(values):.2g}" if len(values) > 1 else ""
    return f"{statistics.fmean(values):.4g}{spread}"
