"""Scores against training time: one curve of several, the Pareto front, and the time to reach a score."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from dofbench.core.errors import Status
from dofbench.evaluation.results.collecting import Entry

UNEVEN = (
    " Processor seconds for a second of training differ by more than a fifth between runs (other work on the machine, "
    "or fewer cores in use), so times are compared as processor time."
)
RULE = (
    "A score counts as reached at the first scored moment that shows it, without interpolation: the time is an upper "
    "bound, and reach.csv has the moment scored before. Over seeds it is the median and the range; a run that failed, "
    "or never reached the score, counts as later than every other."
)
_SHARES = (0.5, 0.8, 0.95)  # of the way from the worst first score to the best: the levels to reach
_UNEVEN, _MEASURED = 1.2, 5.0  # ratio; seconds of training from which it is measured well
_STEPS_A_WAY = 20  # a level is rounded to a step of 1, 2 or 5 times a power of ten, of at most 1 / this of the way

Point = tuple[float, float]  # (training seconds, score)


@dataclass(frozen=True)
class Curve:
    """One seed; seed None for a mean over scenes. points: scored moments with a finite score, by time. dropped: number
    of moments without one."""

    seed: int | None
    status: Status
    points: tuple[Point, ...]
    dropped: int


def uneven_clocks(entries: Iterable[Entry]) -> bool:
    """Whether processor time and wall time of training differ between runs by more than a fifth, so that processor time
    is what can be compared: other work on the machine slows a run down, and methods differ in the cores they use. Runs
    of a few seconds don't tell."""
    scores = [entry.scores for entry in entries if entry.status is Status.OK and entry.result and entry.result.curve]
    times = [(one.get("train_cpu_s", 0.0), wall) for one in scores if (wall := one.get("train_s", 0.0)) >= _MEASURED]
    if not times or not all(cpu > 0 for cpu, _ in times):
        return False
    cores = [cpu / wall for cpu, wall in times]
    return max(cores) > _UNEVEN * min(cores)


def curve_of(entry: Entry, column: str, *, processor: bool = False) -> Curve:
    """One run's curve of one score. processor: over processor time instead of wall time."""
    moments = entry.result.curve if entry.result else ()
    timed = [((point.train_cpu_s if processor else point.train_s) or 0.0, point.scores) for point in moments]
    scored = [(time, scores[column]) for time, scores in timed if column in scores and time > 0]
    points = tuple(point for point in scored if math.isfinite(point[1]))
    return Curve(entry.spec.seed, entry.status, points, len(scored) - len(points))


def joint_curve(curves: Sequence[Sequence[Point]], together: Callable[[Sequence[float]], float]) -> tuple[Point, ...]:
    """One curve of several, without interpolation: a point when each of them has been scored, again when each has
    another score, and at the end. So moments milliseconds apart are one point and not a stair.

    together: makes one score of the last measured ones. Raises ValueError for a curve without a point.
    """
    if not curves or not all(curves):
        raise ValueError("joint curve: expected at least one point of each, found none")
    if len(curves) == 1:
        return tuple(curves[0])
    events = sorted((time, place) for place, curve in enumerate(curves) for time, _ in curve)
    points: list[Point] = []
    scored = [0] * len(curves)
    awaited = set(range(len(curves)))  # those that the last point has no new score of
    for time, group in groupby(events, key=lambda event: event[0]):
        for _, place in group:
            scored[place] += 1
            awaited.discard(place)
        if not awaited or time == events[-1][0]:
            points.append((time, together([curve[count - 1][1] for curve, count in zip(curves, scored, strict=True)])))
            awaited = set(range(len(curves)))
    return tuple(points)


# ---- Pareto front ----


class FrontPoint(NamedTuple):
    """A scored moment on the Pareto front: no other is as early and as good, and earlier or better. series: index."""

    time: float
    score: float
    series: int


def pareto_front(curves: Sequence[Sequence[Point]], *, higher_is_better: bool) -> tuple[FrontPoint, ...]:
    """The front over all points of all curves, by time; of points with equal time and score all are on the front."""
    sign = 1.0 if higher_is_better else -1.0
    points = sorted((time, -sign * score, index) for index, curve in enumerate(curves) for time, score in set(curve))
    front: list[FrontPoint] = []
    best = math.inf
    for time, group in groupby(points, key=lambda point: point[0]):
        at_once = list(group)
        least = at_once[0][1]
        if least < best:
            best = least
            front += [FrontPoint(time, -sign * cost, index) for _, cost, index in at_once if cost == least]
    return tuple(front)


def spans(front: Sequence[FrontPoint]) -> Iterator[tuple[int, Point, Point]]:
    """The front as stretches of one series each, by time: (index of the series, first point, last point)."""
    for series, group in groupby(front, key=lambda point: point.series):
        points = [(time, score) for time, score, _ in group]
        yield series, points[0], points[-1]


# ---- time to reach a score ----


@dataclass(frozen=True)
class Reached:
    """One run. time: training seconds at the first scored moment at the level or better, None without one. before: the
    moment scored before that one, 0 without one. held: whether the last score still reaches the level."""

    time: float | None
    before: float = 0.0
    held: bool = False


def reached(run: Curve, level: float, *, higher_is_better: bool) -> Reached:
    """The first moment at which a run reaches the level; a run that failed reaches none."""
    before = 0.0
    for time, score in run.points if run.status is Status.OK else ():
        if _at_least(score, level, higher_is_better):
            return Reached(time, before, _at_least(run.points[-1][1], level, higher_is_better))
        before = time
    return Reached(None)


@dataclass(frozen=True)
class Reach:
    """Seconds over several seeds: median, low, high, infinite where the level wasn't reached. count: seeds that reached
    it. lost: how many of these have a worse score at the end."""

    median: float
    low: float
    high: float
    seeds: int
    count: int
    lost: int


def reach(runs: Sequence[Curve], level: float, *, higher_is_better: bool) -> Reach:
    """When the seeds reach the level."""
    found = [reached(run, level, higher_is_better=higher_is_better) for run in runs]
    times = [math.inf if one.time is None else one.time for one in found]
    there = [one for one in found if one.time is not None]
    lost = sum(not one.held for one in there)
    return Reach(statistics.median(times), min(times), max(times), len(times), len(there), lost)


def levels(runs: Iterable[Curve], medians: Iterable[Sequence[Point]], *, higher_is_better: bool) -> tuple[float, ...]:
    """Levels at `_SHARES` of the way from the worst first score of the runs to the best of the medians over seeds, each
    rounded to the easier side; none if no run improves its score."""
    firsts = [run.points[0][1] for run in runs if run.points]
    shown = [score for median in medians for _, score in median]
    if not firsts or not shown:
        return ()
    worst, best = (min(firsts), max(shown)) if higher_is_better else (max(firsts), min(shown))
    way = best - worst
    if way == 0 or (way > 0) is not higher_is_better:
        return ()
    step = round_step(abs(way) / _STEPS_A_WAY)
    easier = math.floor if higher_is_better else math.ceil
    # The number of steps is rounded to six decimals before floor or ceil, so that 0.3 / 0.1 counts as 3.
    found = [easier(round((worst + share * way) / step, 6)) * step for share in _SHARES]
    digits = max(0, -math.floor(math.log10(step)))
    return tuple(dict.fromkeys(round(level, digits) for level in found))


def round_step(largest: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that isn't above `largest`, which is positive."""
    power = 10.0 ** math.floor(math.log10(largest))
    return next(factor * power for factor in (5.0, 2.0, 1.0) if factor * power <= largest * (1 + 1e-9) or factor == 1.0)


def _at_least(score: float, level: float, higher_is_better: bool) -> bool:
    return score >= level if higher_is_better else score <= level
