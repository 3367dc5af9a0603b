"""The curves as data for the script that draws them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dofbench.reporting.plots import Plot
from dofbench.reporting.series import Series


def plot_data(plots: Sequence[Plot]) -> list[dict[str, Any]]:
    """The plots as plain data: the curves, and the labels of axes and values."""
    return [_one(plot) for plot in plots]


def _one(plot: Plot) -> dict[str, Any]:
    return {
        "board": plot.title,
        "column": plot.column,
        "label": plot.score.label,
        "heading": plot.score.heading,
        "unit": plot.score.unit,
        "digits": plot.score.digits,
        "higher": plot.higher_is_better,
        "note": plot.score.note,
        "nothing": plot.nothing,
        "levels": list(plot.levels),
        "series": [_series(series) for series in plot.series],
        "front": [[_number(point.time), _number(point.score), point.series] for point in plot.front],
    }


def _series(series: Series) -> dict[str, Any]:
    return {
        "name": series.label,
        "place": series.place,
        "failures": series.failures,
        "runs": [{"seed": run.seed, "points": _points(run.points), "dropped": run.dropped} for run in series.runs],
        "median": _points(series.median) if len(series.runs) > 1 else [],
    }


def _points(points: Sequence[tuple[float, float]]) -> list[list[float]]:
    return [[_number(time), _number(score)] for time, score in points]


def _number(value: float) -> float:
    """The value rounded to six digits: more are invisible, and would double the size of the page."""
    return float(f"{value:.6g}")
