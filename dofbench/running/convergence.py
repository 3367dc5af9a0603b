"""`dofbench run --converge`: trainings of doubled length until held-out PSNR stops rising.

Learning rates and density control are shares of a training's length, so a longer training is a new one, not a finished
one prolonged. Every length is an ordinary run with its own folder, and a cached one is used again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from dofbench.core.budget import Budget
from dofbench.core.contracts import PredictsPhotographs
from dofbench.core.errors import InputError, Status
from dofbench.core.jobs import Executor
from dofbench.core.progress import say
from dofbench.methods.cards import find_method
from dofbench.running.batch import Batch, executor_for
from dofbench.running.matrix import all_lines, plan_matrix, print_table, summary
from dofbench.running.plan import Plan
from dofbench.running.run_options import Runs

# The rule, the same for every method
LEAST_GAIN = 0.1  # dB of held-out PSNR from half the length to the whole
MOST_STEPS = 30_000  # of one training
MOST_MINUTES = 40  # of one training, wall time, on two cores
RULE = (
    f"until PSNR on held-out pixels of the training views rises by less than {LEAST_GAIN:g} dB from one to the next; "
    f"at most {MOST_STEPS} steps or {MOST_MINUTES} minutes of training"
)
_SCORE = "held_out_psnr"


@dataclass(frozen=True)
class Length:
    """One training of a cell. steps: planned. psnr: on held-out pixels, dB. seconds: of training. failure: "" if it
    ended well."""

    steps: int
    psnr: float = math.nan
    seconds: float = 0.0
    failure: str = ""


@dataclass(frozen=True)
class Verdict:
    """Whether a longer training follows, and if not, why."""

    goes_on: bool
    words: str = ""


def verdict(lengths: Sequence[Length]) -> Verdict:
    """Apply the rule to the trainings of a cell so far, each twice as long as the one before; at least one."""
    last = lengths[-1]
    if last.failure:
        return Verdict(False, f"failed at {last.steps} steps: {last.failure}")
    if not math.isfinite(last.psnr):
        return Verdict(False, f"failed at {last.steps} steps: no finite held-out PSNR")
    if len(lengths) > 1 and last.psnr - lengths[-2].psnr < LEAST_GAIN:
        return Verdict(False, f"converged at {last.steps} steps")
    if 2 * last.steps > MOST_STEPS:
        return Verdict(False, f"not converged at {last.steps} steps: limit of {MOST_STEPS} steps")
    if 2 * last.seconds > 60 * MOST_MINUTES:
        return Verdict(False, f"not converged at {last.steps} steps: limit of {MOST_MINUTES} minutes")
    return Verdict(True)


def converge_all(
    settings: Runs, builtin: Path, console: Console | None = None, executor: Executor | None = None
) -> bool:
    """Make the runs of every round of the settings' matrix; a round has the cells that go on, twice as long.

    builtin, executor: as in `run_all`. False when a run failed. Raises InputError when the call is wrong, before
    anything runs.
    """
    console = console or Console()
    cells = list(settings.cells())
    runs = plan_matrix(tuple(cells), builtin)
    _check(runs)
    going, lengths = list(range(len(cells))), [list[Length]() for _ in cells]
    firsts, made = runs, list(runs)
    failures: list[str] = []
    say(console, f"lengths  doubled {RULE}")
    while going:
        batch = Batch(runs, settings.out, executor or executor_for(runs, settings, settings.out), rerun=settings.rerun)
        first = runs is firsts
        full = settings.dry_run or settings.verbose
        for line in (all_lines(settings, batch) if full else summary(batch)) if first else _round(batch, len(cells)):
            say(console, line)
        if settings.dry_run:
            return True
        batch.make()
        failures += batch.failures()
        for cell, run in zip(going, runs, strict=True):
            lengths[cell].append(_length(run, batch))
        going = [cell for cell in going if verdict(lengths[cell]).goes_on]
        for cell in going:
            cells[cell] = replace(cells[cell], budget=Budget(steps=2 * lengths[cell][-1].steps))
        runs = plan_matrix(tuple(cells[cell] for cell in going), builtin)
        made += runs
    print_table(console, Batch(made, settings.out, executor or executor_for(made, settings, settings.out)))
    for run, own in zip(firsts, lengths, strict=True):
        say(console, f"{_named(run)}: {_line(own)}")
    for line in failures:
        say(console, line)
    say(console, f"report: dofbench report {settings.out}")
    return not failures


def _check(runs: Sequence[Plan]) -> None:
    for run in runs:
        if run.budget.steps is None or run.budget.seconds is not None:
            found = f"a budget in time, {run.budget}, with --converge"
            raise InputError(f"preset {run.spec.preset} of {run.spec.method}", found, "--budget in steps")
        if not isinstance(find_method(run.spec.method).method_class(), PredictsPhotographs):
            found = f"{run.spec.method}, which doesn't predict its training views"
            raise InputError("--converge", found, "methods that do, to be scored on held-out pixels")


def _length(run: Plan, batch: Batch) -> Length:
    entry, steps = batch.ended.find(run), run.budget.steps or 0
    if entry is None or entry.status is not Status.OK:
        return Length(steps, failure="not run" if entry is None else f"{entry.status}: {entry.message}")
    return Length(steps, entry.scores.get(_SCORE, math.nan), entry.scores["train_s"])


def _round(batch: Batch, cells: int) -> list[str]:
    lengths = ", ".join(dict.fromkeys(str(run.budget.steps) for run in batch.runs))
    outlook = batch.outlook()
    return [f"{len(batch.runs)} of {cells} go on, to {lengths} steps", *outlook[-1:]]


def _named(run: Plan) -> str:
    return f"{run.spec.method} ({run.spec.preset}, seed {run.spec.seed}) on {run.spec.dataset}"


def _line(lengths: Sequence[Length]) -> str:
    """`converged at 6000 steps; held-out PSNR 30.17 → 30.12 dB at 3000, 6000 steps, best at 3000`."""
    good = [length for length in lengths if not length.failure]
    words = verdict(lengths).words
    if not good:
        return words
    scores, steps = " → ".join(f"{one.psnr:.2f}" for one in good), ", ".join(str(one.steps) for one in good)
    best = max(good, key=lambda one: one.psnr).steps
    return f"{words}; held-out PSNR {scores} dB at {steps} steps, best at {best}"
