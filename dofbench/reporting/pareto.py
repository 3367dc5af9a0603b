"""The Pareto front of score against training time, over methods and presets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from dofbench.reporting.series import Point, Series


@dataclass(frozen=True)
class FrontPoint:
    """A scored moment on the Pareto front: no other moment is at least as early and as good, and earlier or better.
    series: index of its series."""

    time: float
    score: float
    series: int


def pareto_front(curves: Sequence[Sequence[Point]], *, higher_is_better: bool) -> tuple[FrontPoint, ...]:
    """The front over all points of all curves, by time; of points with equal time and score all are on the front."""
    sign = 1.0 if higher_is_better else -1.0
    points = sorted((time, -sign * score, index) for index, curve in enumerate(curves) for time, score in set(curve))
    front: list[FrontPoint] = []
    best = float("inf")
    for time, group in groupby(points, key=lambda point: point[0]):
        at_once = list(group)
        least = at_once[0][1]
        if least < best:
            best = least
            front += [FrontPoint(time, -sign * cost, index) for _, cost, index in at_once if cost == least]
    return tuple(front)


@dataclass(frozen=True)
class Span:
    """A stretch of the front that belongs to one series, by its first and last point."""

    series: int
    first: Point
    last: Point


def spans(front: Sequence[FrontPoint]) -> tuple[Span, ...]:
    """The front as stretches of one series each, by time."""
    held = []
    for series, group in groupby(front, key=lambda point: point.series):
        points = list(group)
        held.append(Span(series, (points[0].time, points[0].score), (points[-1].time, points[-1].score)))
    return tuple(held)


def front_of(series: Sequence[Series], *, higher_is_better: bool) -> tuple[FrontPoint, ...]:
    """The front of the medians over seeds; a series without a median, because a seed failed, is left out."""
    return pareto_front([one.median for one in series], higher_is_better=higher_is_better)
