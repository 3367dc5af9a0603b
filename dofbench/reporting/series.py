"""Score against training time, as plain data: every run's curve, the median over seeds, and the mean over scenes."""

from __future__ import annotations

import bisect
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dofbench.core.errors import Status
from dofbench.evaluation.figures import LOOKS
from dofbench.evaluation.results.collecting import Entry, grouped
from dofbench.evaluation.results.columns import COLUMNS
from dofbench.reporting import standing

Point = tuple[float, float]  # (training seconds, score)


@dataclass(frozen=True)
class Run:
    """One seed; None for a mean over scenes. points: every scored moment with a finite score, by time. dropped: moments
    whose score isn't finite, which can't be drawn and reach no level."""

    seed: int | None
    status: Status
    points: tuple[Point, ...]
    dropped: int


@dataclass(frozen=True)
class Series:
    """The seeds of one variant. median: the median curve over its seeds; empty if a seed failed or has no point. place:
    its number among the report's variants, by which it looks the same in every plot. signs: what its results don't
    prove (`dofbench.reporting.standing`)."""

    variant: tuple[str, ...]
    method: str
    preset: str
    runs: tuple[Run, ...]
    median: tuple[Point, ...]
    place: int
    signs: str = ""

    @property
    def name(self) -> str:
        """Method and preset."""
        return f"{self.method} {self.preset}".strip()

    @property
    def label(self) -> str:
        """Method and preset with the signs, as legends show them."""
        return f"{self.name} {self.signs}".strip()

    def rank(self, *, higher_is_better: bool) -> tuple[bool, float]:
        """By what series are put in order, the best first: its last score, after all others where a seed failed."""
        last = statistics.median(run.points[-1][1] for run in self.runs if run.points)
        return not self.median, -last if higher_is_better else last

    @property
    def failures(self) -> str:
        """How runs of this variant failed; empty if none did."""
        return ", ".join(sorted({str(run.status) for run in self.runs if run.status is not Status.OK}))


def curve_columns(entries: Sequence[Entry]) -> list[str]:
    """The scores that any curve has, in the order of the tables."""
    found = {column for entry in entries if entry.result for point in entry.result.curve for column in point.scores}
    return [column for column in COLUMNS if column in found]


def series_of(
    entries: Sequence[Entry], column: str, names: dict[tuple[str, ...], tuple[str, str]]
) -> tuple[Series, ...]:
    """The series of one board, without series that have no point. names: of all variants of the report."""
    found = []
    role, variants = standing.role_of(entries), grouped(list(entries), "variant")
    # With more variants than looks two lines of one plot could look alike, if places were the report's.
    places = list(names if len(names) <= LOOKS else variants)
    for variant, seeds in variants.items():
        runs = tuple(run_of(entry, column) for entry in seeds)
        if not any(run.points for run in runs):
            continue
        whole = all(run.points and run.status is Status.OK for run in runs)
        median = median_curve([run.points for run in runs]) if whole else ()
        found.append(Series(variant, *names[variant], runs, median, places.index(variant), standing.signs(role, seeds)))
    return tuple(found)


def run_of(entry: Entry, column: str) -> Run:
    """One run's curve of one score."""
    scored = [
        (point.train_s, point.scores[column])
        for point in (entry.result.curve if entry.result else ())
        if column in point.scores and point.train_s > 0
    ]
    points = tuple(point for point in scored if math.isfinite(point[1]))
    return Run(entry.spec.seed, entry.status, points, len(scored) - len(points))


def mean_series(scenes: Sequence[Sequence[Series]]) -> tuple[Series, ...]:
    """Means over scenes, of the variants that have a median over seeds on each. scenes: the series of each."""
    own = [{series.variant: series for series in found if series.median} for found in scenes]
    means = []
    for variant in own[0]:
        if not all(variant in one for one in own):
            continue
        every = [one[variant] for one in own]
        curve = joint_curve([series.median for series in every], statistics.fmean)
        signs = standing.united(series.signs for series in every)
        first = every[0]
        run = Run(None, Status.OK, curve, 0)
        means.append(Series(variant, first.method, first.preset, (run,), curve, first.place, signs))
    return tuple(means)


def median_curve(curves: Sequence[Sequence[Point]]) -> tuple[Point, ...]:
    """Median over seeds, as `joint_curve` has it; for an even number of seeds the mean of the two middle values."""
    return joint_curve(curves, statistics.median)


def joint_curve(curves: Sequence[Sequence[Point]], together: Callable[[Sequence[float]], float]) -> tuple[Point, ...]:
    """One curve of several: a point when each of them has been scored, again when each has another score, and at the
    end. So moments that are the same by plan, and milliseconds apart, are one point and not a stair.

    Between two scored moments a curve's score is the last measured one: no value is interpolated. together: makes one
    score of all. Raises ValueError for a curve without a point.
    """
    if not curves or not all(curves):
        raise ValueError("joint curve: expected at least one point of each, found none")
    if len(curves) == 1:
        return tuple(curves[0])
    moments = [[time for time, _ in curve] for curve in curves]
    times = sorted({time for own in moments for time in own})
    points: list[Point] = []
    shown = [0] * len(curves)  # how many scores of each the last point took in
    for time in times:
        scored = [bisect.bisect_right(own, time) for own in moments]
        if time == times[-1] or all(now > before for now, before in zip(scored, shown, strict=True)):
            points.append((time, together([curve[count - 1][1] for curve, count in zip(curves, scored, strict=True)])))
            shown = scored
    return tuple(points)
