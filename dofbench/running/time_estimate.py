"""How long a run will take, by runs that are finished."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from dofbench.core.errors import InputError, Status
from dofbench.results.result import RESULT_FILE, Result, read_result
from dofbench.running.planned_runs import PlannedRun


def finished_results(folder: Path) -> list[Result]:
    """Every result below `folder` that went well; those that can't be read are no business of an estimate."""
    found = []
    for file in sorted(folder.rglob(RESULT_FILE)) if folder.is_dir() else ():
        try:
            result = read_result(file)
        except InputError:
            continue
        if result.status is Status.OK:
            found.append(result)
    return found


def expected_seconds(run: PlannedRun, finished: Sequence[Result]) -> float | None:
    """Wall seconds of a run: the median over the finished ones that are most like it, their training scaled by the
    budget. Like are those on the same dataset, before all of the same method and preset. Without any, the budget's
    own seconds; None where it has none."""
    spec, budget = run.spec, run.plan.budget
    alike = [
        (result.spec.method == spec.method, result.spec.preset == spec.preset, result)
        for result in finished
        if result.spec.dataset_checksum == spec.dataset_checksum
    ]
    nearest = max((closeness[:2] for closeness in alike), default=None)
    known = [
        _scaled(result, budget.steps, budget.seconds) for *closeness, result in alike if tuple(closeness) == nearest
    ]
    return statistics.median(known) if known else budget.seconds


def time_to_go(runs: Sequence[PlannedRun], seconds: Sequence[float | None], workers: int) -> str:
    """One line about all of `runs`; `seconds` are theirs."""
    known = [one for one in seconds if one is not None]
    if not known:
        return "no finished run of this kind to estimate the time from"
    total = sum(known) * len(runs) / len(known) / workers
    how = f"{workers} at a time, by the runs that are finished and the budgets"
    return f"about {total:.0f} s to go, {how}" if total < 90 else f"about {total / 60:.0f} min to go, {how}"


def _scaled(result: Result, steps: int | None, seconds: float | None) -> float:
    training = result.stages["train"].wall if "train" in result.stages else 0.0
    rest = sum(stage.wall for stage in result.stages.values()) - training
    took = result.scores.get("steps", 0.0)
    if steps is not None and took > 0:
        training *= steps / took
        return rest + (training if seconds is None else min(training, seconds))
    return rest + (training if seconds is None else seconds)
