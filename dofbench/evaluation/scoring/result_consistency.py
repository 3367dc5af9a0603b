"""Checks a result's consistency, as far as possible without its images and its dataset."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

from dofbench.core.errors import Status
from dofbench.evaluation.metrics import METRICS
from dofbench.evaluation.results.added_scores import Added
from dofbench.evaluation.results.columns import WEIGHTED
from dofbench.evaluation.results.protocol import (
    AIF_PREFIX,
    DEPTH_COLUMNS,
    EVIDENCE_COLUMNS,
    EXIF_COLUMNS,
    EXIF_FOCUS_COLUMNS,
    LENS_COLUMNS,
    PICTURE_BLUR,
    PROTOCOLS,
    arithmetic_mean,
)
from dofbench.evaluation.results.result import Result
from dofbench.evaluation.scoring.exif_scores import exif_focus_scores, exif_scores
from dofbench.evaluation.scoring.photographs.lens_evidence import cannot_rank

MEAN_AGREEMENT = 1e-9  # tolerated relative difference between a mean and the mean of its values
_PLANNED = ("method", "preset", "dataset", "protocol", "budget", "seed", "device", "options")


def inconsistencies(result: Result) -> list[str]:
    """All inconsistencies of the result, one line each."""
    checks = _identity, _columns, _means, _lenses, _by_exif, _ranking, _ending, _times
    return [line for check in checks for line in check(result)]


def added_inconsistencies(added: Added, result: Result) -> Iterator[str]:
    """Inconsistencies of the scores added to the result, one line each."""
    if added.key != result.key:
        yield f"added scores of the key {added.key[:8]}…, the result's is {result.key[:8]}…"
    views = {view.name for view in result.views}
    for column, score in added.scores.items():
        if column.removeprefix(AIF_PREFIX) not in METRICS and column not in (*WEIGHTED, *PICTURE_BLUR):
            yield f"added {column}: no such metric"
        if (column in WEIGHTED) != bool(score.weights):
            yield f"added {column}: {'no sha256' if column in WEIGHTED else 'a sha256'} of weights"
        if column in result.scores:
            yield f"added {column}: the result itself has this score"
        if set(score.views) != views:
            yield f"added {column}: its views aren't those of the result"
        elif score.views:
            yield from differing(f"added {column}", score.value, arithmetic_mean(list(score.views.values())))


def differing(column: str, stored: float | None, mean: float) -> list[str]:
    """One line if `stored` isn't the mean of its per-view values, else none."""
    if stored is None:
        return [f"{column}: no mean, though there are per-view values"]
    same = stored == mean or (math.isnan(stored) and math.isnan(mean))
    if same or math.isclose(stored, mean, rel_tol=MEAN_AGREEMENT, abs_tol=MEAN_AGREEMENT):
        return []
    return [f"{column}: {stored:.6g} is not the mean of the per-view values, {mean:.6g}"]


def _identity(result: Result) -> Iterator[str]:
    if result.spec.key != result.key:
        yield f"the key is {result.key[:8]}…, the spec's hash {result.spec.key[:8]}…"
    known = PROTOCOLS.get(result.spec.protocol)
    if known is None:
        yield f"unknown protocol {result.spec.protocol!r}, expected one of {', '.join(PROTOCOLS)}"
    else:
        said = known.as_data()
        # JSON turned tuples into lists. Parts added to the protocol since aren't compared, nor scores of photographs.
        since = {**said, "photograph": said["photograph"][: len(result.protocol.get("photograph", ()))]}
        changed = [
            name
            for name, value in result.protocol.items()
            if name in since and value != (list(since[name]) if isinstance(since[name], tuple) else since[name])
        ]
        yield from (f"protocol {known.id}: its {name} is not what that protocol says" for name in changed)
    spec = result.spec.model_dump(mode="json")
    yield from (
        f"the plan's {name} is {result.plan[name]!r}, the spec's {spec[name]!r}"
        for name in _PLANNED
        if name in result.plan and result.plan[name] != spec[name]
    )


def _columns(result: Result) -> Iterator[str]:
    """Every planned score must have either a value or a reason why it is missing."""
    for column in result.scores:
        if column in result.left_out:
            yield f"{column}: a score, and a reason why there is none"
    for column, reason in {**result.left_out, **result.left_out_stages}.items():
        if not reason.strip():
            yield f"{column}: skipped without a reason"
    if result.status is Status.OK:
        for column in result.plan.get("columns", []):
            if column not in result.scores and column not in result.left_out:
                yield f"no score {column}, though the plan has it"


def _means(result: Result) -> Iterator[str]:
    """Scores must be the means of their per-view values."""
    columns = list(result.views[0].scores) if result.views else []
    for column in columns:
        if any(column not in view.scores for view in result.views):
            yield f"{column}: not of every view"
            continue
        mean = arithmetic_mean([view.scores[column] for view in result.views])
        yield from differing(column, result.scores.get(column), mean)
    for column in ("delta_a", "delta_f") if result.lens else ():
        mean = arithmetic_mean([getattr(view, column) for view in result.lens])
        yield from differing(column, result.scores.get(column), mean)
    of_lenses = (*LENS_COLUMNS, *EXIF_COLUMNS, *EXIF_FOCUS_COLUMNS)
    images = [column for column in result.plan.get("columns", []) if column not in of_lenses]
    for column in images:
        if column in result.scores and column not in columns:
            yield f"{column}: a mean without per-view values"


def _lenses(result: Result) -> Iterator[str]:
    for view in result.lens:
        for column, true, found in (
            ("delta_a", view.aperture, view.aperture_estimated),
            ("delta_f", view.focus, view.focus_estimated),
        ):
            error = abs(true - found)
            if not math.isclose(getattr(view, column), error, rel_tol=MEAN_AGREEMENT, abs_tol=MEAN_AGREEMENT):
                yield f"view {view.name}: {column} is {getattr(view, column):.6g}, its lenses differ by {error:.6g}"
    assigned = result.plan.get("lenses")
    if assigned is None:  # an older result
        return
    for view in result.lens:
        if assigned["train"].get(view.name) != [view.aperture, view.focus]:
            yield f"view {view.name}: another true lens than the plan's"
    if result.views and sorted(view.name for view in result.views) != sorted(assigned["test"]):
        yield "scores of other views than the plan's test views"


def _by_exif(result: Result) -> Iterator[str]:
    """Scores against EXIF must follow from the stored apertures and foci."""
    scores = exif_scores(result.apertures)[0] | exif_focus_scores(result.foci)[0]
    for column in (*EXIF_COLUMNS, *EXIF_FOCUS_COLUMNS):
        stored = result.scores.get(column)
        if column in scores and result.status is Status.OK:
            yield from differing(column, stored, scores[column])
        elif stored is not None and column not in scores:
            yield f"{column}: a score, which the learned lenses don't give"


def _ranking(result: Result) -> Iterator[str]:
    """Whether the dataset can rank lenses must follow from the two shares."""
    energy, seen = (result.scores.get(column) for column in EVIDENCE_COLUMNS)
    said = "" if energy is None or seen is None else cannot_rank(energy, seen)
    if bool(said) != bool(result.no_ranking):
        yield f"no_ranking: {result.no_ranking or 'no reason'}, though its shares say {said or 'no reason'}"


def _ending(result: Result) -> Iterator[str]:
    """A NaN score must be recorded as an event, and a run with such an event must not have the status ok."""
    scored = [(view.name, column, value) for view in result.views for column, value in view.scores.items()]
    lost = [f"view {name}: {column} is nan" for name, column, value in scored if math.isnan(value)]
    if result.status is Status.OK:
        yield from (f"{line}, and the run ended ok" for line in lost)
        yield from (f"{event.stage}: {event.detail}, and the run ended ok" for event in result.nonfinite)
        return
    if not result.message.strip():
        yield f"ended {result.status} without a message"
    if lost and not result.nonfinite:
        yield f"{lost[0]}, and no event says so"
    scored_depth = any(math.isfinite(result.scores.get(column, math.nan)) for column in DEPTH_COLUMNS)
    if result.views and scored_depth and not result.nonfinite:
        yield f"ended {result.status}, with scores all the same"


def _times(result: Result) -> Iterator[str]:
    stages = result.stages
    started = [stages[name].wall for name in ("import", "warm up") if name in stages]
    expected = {
        "train_s": stages["train"].wall if "train" in stages else None,
        "train_cpu_s": stages["train"].cpu if "train" in stages else None,
        "cold_start_s": sum(started) if len(started) == 2 else None,
    }
    for column, seconds in expected.items():
        if seconds is not None and column in result.scores and not math.isclose(result.scores[column], seconds):
            yield f"{column} is {result.scores[column]:.6g}, its stages took {seconds:.6g}"
    for name, stage in stages.items():
        if not (0 <= stage.wall < math.inf and 0 <= stage.cpu < math.inf):
            yield f"stage {name}: {stage.wall} s, {stage.cpu} s of processor"
    for before, after in pairwise(result.curve):
        if after.train_s < before.train_s or after.steps <= before.steps:
            yield f"the curve goes back, from step {before.steps} to step {after.steps}"
    if result.curve and result.curve[-1].train_s > result.scores.get("train_s", math.inf):
        yield "the curve goes on after the end of training"
    if result.curve and result.status is Status.OK and result.curve[-1].steps != result.scores.get("steps"):
        yield f"the curve ends at step {result.curve[-1].steps}, the training at {result.scores.get('steps')}"
