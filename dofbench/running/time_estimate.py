"""What a run will take, by runs that are finished, or roughly by its method's card."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError, Status
from dofbench.core.files import files_below
from dofbench.core.jobs import Resources
from dofbench.evaluation.results.protocol import PROTOCOLS
from dofbench.evaluation.results.result import RESULT_FILE, Result, read_result
from dofbench.methods.cards import Card, find_method
from dofbench.running.plan import Plan

# Seconds on two cores: a pixel of a test view, scored at the end, and along the training. A photograph of unknown lens
# costs more, as a lens is fitted to it each time.
_SCORED_PIXEL, _CURVE_PIXEL = 1e-5, 1e-5
_FITTED_PIXEL, _FITTED_CURVE_PIXEL = 3e-5, 2.5e-4
_BEGINS = 8.0  # s: a process starts, imports and takes a first step, its kernels compiled before
_ON_CURVE = 4  # test views that are scored along the training, at most


def finished_results(folder: Path) -> list[Result]:
    """Every result below `folder` that went well; those that can't be read are no business of an estimate."""
    found = []
    for file in files_below(folder, RESULT_FILE):
        try:
            result = read_result(file)
        except InputError:
            continue
        if result.status is Status.OK:
            found.append(result)
    return found


def expected(run: Plan, finished: Sequence[Result]) -> Resources:
    """What a run takes: the medians over the finished ones that are most like it, their training scaled by the budget.
    Like are those on the same dataset and device, before all of the same method and preset. Without any, the seconds
    that the method's card makes of steps and pixels on a CPU, which may be half or twice what they are; None where it
    says nothing."""
    spec, budget = run.spec, run.budget
    alike = [
        ((result.spec.method == spec.method, result.spec.preset == spec.preset), result)
        for result in finished
        if (result.spec.dataset_checksum, result.spec.device) == (spec.dataset_checksum, spec.device)
    ]
    nearest = max((closeness for closeness, _ in alike), default=None)
    known = [result for closeness, result in alike if closeness == nearest]
    if not known:
        card = find_method(spec.method).card
        seconds = seconds_by_card(
            card if spec.device == "cpu" else card.model_copy(update={"costs": None}),
            budget,
            run.options.get("steps"),
            view_pixels=run.view_pixels,
            train_views=run.by_data.train_views,
            test_views=run.by_data.test_views,
            fitted=bool(PROTOCOLS[spec.protocol].photograph),
        )
        return Resources(spec.device, seconds=seconds)
    took = statistics.median(_scaled(result, budget.steps, budget.seconds) for result in known)
    same = [result.scores["peak_mb"] for result in known if "peak_mb" in result.scores] if all(nearest or ()) else []
    return Resources(spec.device, statistics.median(same) if same else None, took)


def time_to_go(runs: Sequence[Resources], at_a_time: int, by: str) -> str:
    """One line about all of `runs`. by: what the estimate rests on."""
    known = [one.seconds for one in runs if one.seconds is not None]
    if not known:
        return "no finished run of this kind to estimate the time from, and the method's card says nothing of it"
    total = sum(known) * len(runs) / len(known) / min(at_a_time, len(runs))
    how = f"{at_a_time} at a time, {by}" if len(runs) > 1 else by
    return f"about {total:.0f} s to go, {how}" if total < 90 else f"about {total / 60:.0f} min to go, {how}"


def seconds_by_card(
    card: Card,
    budget: Budget,
    steps: int | None,
    *,
    view_pixels: float,
    train_views: int,
    test_views: int,
    fitted: bool,
) -> float | None:
    """Wall seconds of a run by what its method's card says of steps and pixels; the budget's own seconds where it says
    nothing, None without either. steps: of the method's options, where the budget has none. view_pixels: of a view.
    fitted: whether the test views are photographs of unknown lens."""
    costs = card.costs
    end, curve = (_FITTED_PIXEL, _FITTED_CURVE_PIXEL) if fitted else (_SCORED_PIXEL, _CURVE_PIXEL)
    others = _BEGINS + view_pixels * (test_views * end + min(test_views, _ON_CURVE) * curve)
    ends = [] if budget.seconds is None else [budget.seconds]
    # Seconds alone are all used, so that the preset's steps count only where the budget says nothing.
    length = budget.steps or (None if ends else steps)
    if costs is not None:
        others += train_views * view_pixels * costs.view_pixel
        if length:
            ends.append(length * (costs.step + view_pixels * costs.step_pixel))
    return min(ends) + others if ends else None


def _scaled(result: Result, steps: int | None, seconds: float | None) -> float:
    training = result.stages["train"].wall if "train" in result.stages else 0.0
    rest = sum(stage.wall for stage in result.stages.values()) - training
    took = result.scores.get("steps", 0.0)
    if steps is not None and took > 0:
        training *= steps / took
        return rest + (training if seconds is None else min(training, seconds))
    return rest + (training if seconds is None else seconds)
