"""Means over seeds and over scenes, with the reason of every gap."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry
from dofbench.evaluation.results.columns import (
    ALL_IN_FOCUS,
    EXIF,
    HELD_OUT_SCORES,
    OF_PHOTOGRAPH_RUNS,
    PHOTOGRAPH,
    REFOCUS,
    SCORES,
    WEIGHTED,
)
from dofbench.evaluation.results.protocol import (
    BLUR_COLUMNS,
    DEPTH_COLUMNS,
    PICTURE_BLUR,
    PROTOCOLS,
    arithmetic_mean,
    kind_prefix,
)


@dataclass(frozen=True)
class Statistic:
    """A score over several runs. value: None with a failure (a status) or a reason, shown as a footnote. spread: sample
    standard deviation over seeds, None for a single seed."""

    value: float | None
    spread: float | None = None
    failure: str = ""
    reason: str = ""


def seed_mean(entries: Sequence[Entry], column: str) -> Statistic:
    """One column over the seeds of one variant; no mean if a seed failed."""
    failed = [entry for entry in entries if entry.status is not Status.OK]
    if failed:
        kinds = ", ".join(sorted({str(entry.status) for entry in failed}))
        count = f" ({len(failed)} of {len(entries)} seeds)" if len(entries) > 1 else ""
        return Statistic(None, failure=kinds + count, reason=failed[0].message or "no message")
    lacking = next((entry for entry in entries if column not in entry.scores), None)
    if lacking is not None:
        return Statistic(None, reason=lacking.left_out.get(column) or _no_reason(lacking, column))
    return mean_and_spread([entry.scores[column] for entry in entries])


def mean_and_spread(values: Sequence[float], reason: str = "") -> Statistic:
    """Mean and sample standard deviation of one value per seed; a gap with the reason without values."""
    if not values:
        return Statistic(None, reason=reason)
    spread = statistics.stdev(values) if len(values) > 1 and all(map(math.isfinite, values)) else None
    return Statistic(arithmetic_mean(values), spread)


def _no_reason(entry: Entry, column: str) -> str:
    """Why a score is missing where the result doesn't say; "" if it belongs to another protocol."""
    protocol = PROTOCOLS.get(entry.spec.protocol)
    if protocol is not None and column in DEPTH_COLUMNS and not protocol.depth:
        return f"{protocol.id} has no such score"
    if column in (*EXIF, *OF_PHOTOGRAPH_RUNS, *HELD_OUT_SCORES):
        return ""
    if column in SCORES:
        of_images = column in (*REFOCUS, *ALL_IN_FOCUS, *PHOTOGRAPH)
        foreign = protocol is not None and of_images and column not in protocol.image_columns
        if column in BLUR_COLUMNS and not foreign:
            later = ": `dofbench score` adds it" if column in PICTURE_BLUR else ""
            return f"the run was scored before its protocol had it{later}"
        return "" if foreign else "the result holds no such score, nor a reason"
    if column in WEIGHTED:
        foreign = protocol is not None and f"{kind_prefix(column)}psnr" not in protocol.image_columns
        return "" if foreign else "not computed: `dofbench score --lpips` adds it"
    return "not computed: `dofbench score` adds it"


def scene_mean(
    found: Mapping[str, Statistic], scenes: Sequence[str], runs: Sequence[Sequence[Entry]] = (), column: str = ""
) -> Statistic:
    """Mean over scenes of one score (scene -> its mean over seeds); a gap unless every scene has a value. runs: each
    scene's, for the standard deviation of this mean over the seeds that all have."""
    missing = [scene for scene in scenes if scene not in found or found[scene].value is None]
    if missing:
        gaps = {(found[scene].failure, found[scene].reason) for scene in missing if scene in found}
        if len(missing) == len(scenes) and len(gaps) == 1:
            failure, reason = gaps.pop()  # missing on all scenes for the same reason
            return Statistic(None, failure=failure, reason=reason)
        absent = ", ".join(missing)
        return Statistic(None, reason=f"no mean over an incomplete set: {absent} missing of {len(scenes)} scenes")
    values = [found[scene].value for scene in scenes]
    spread = _scene_spread(runs, column) if runs else None
    return Statistic(arithmetic_mean([value for value in values if value is not None]), spread)


def _scene_spread(seeds: Sequence[Sequence[Entry]], column: str) -> float | None:
    """Sample standard deviation over seeds of the mean over scenes; None unless all scenes have the same seeds."""
    by_scene = [{entry.spec.seed: entry.scores.get(column) for entry in own} for own in seeds]
    common = sorted(by_scene[0])
    if len(common) < 2 or any(sorted(own) != common for own in by_scene):
        return None
    rows = [[own[seed] for own in by_scene] for seed in common]
    means = [arithmetic_mean([value for value in row if value is not None]) for row in rows if None not in row]
    return statistics.stdev(means) if len(means) == len(common) and all(map(math.isfinite, means)) else None
