"""Error against run time in the page: the curves as data for the script that draws them, and their tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

from dofbench.reporting.html.markup import Td, Th, number_cell, table, text_cell
from dofbench.reporting.pareto import spans
from dofbench.reporting.plots import Plot
from dofbench.reporting.reach import ReachCell, level_text, reach_cell, seconds_text
from dofbench.reporting.series import Series


def plot_data(plots: Sequence[Plot]) -> list[dict[str, Any]]:
    """The plots as plain data: what is drawn, and how its axes and values read."""
    return [_one(plot) for plot in plots]


def plot_tables(plots: Sequence[Plot]) -> str:
    """For each plot its times to reach levels, and who holds the Pareto front; the script shows those of one plot."""
    return "".join(
        f'<div class="plot-tables" data-plot="{index}"><h4>{escape(title(plot))}</h4>{_reach(plot)}{_front(plot)}</div>'
        for index, plot in enumerate(plots)
    )


def title(plot: Plot) -> str:
    """As "PSNR on fern, refocus-v2"."""
    return f"{plot.score.label} on {plot.dataset}, {plot.protocol}"


def _one(plot: Plot) -> dict[str, Any]:
    return {
        "board": f"{plot.dataset}, {plot.protocol}",
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
        "name": series.name,
        "failures": series.failures,
        "runs": [{"seed": run.seed, "points": _points(run.points), "dropped": run.dropped} for run in series.runs],
        "median": _points(series.median) if len(series.runs) > 1 else [],
    }


def _points(points: Sequence[tuple[float, float]]) -> list[list[float]]:
    return [[_number(time), _number(score)] for time, score in points]


def _number(value: float) -> float:
    """Six digits: more can't be seen, and would double the page."""
    return float(f"{value:.6g}")


def _reach(plot: Plot) -> str:
    if not plot.levels:
        return "<p>No level to reach: no score moved while training.</p>"
    headings = [Th("method and preset", words=True), *(Th(level_text(plot.column, level)) for level in plot.levels)]
    rows = [
        [
            text_cell(series.name),
            *(_reach_cell(reach_cell(series, level, higher_is_better=plot.higher_is_better)) for level in plot.levels),
        ]
        for series in plot.series
    ]
    return table(headings, rows, f"Training time to reach a score: {title(plot)}")


def _reach_cell(cell: ReachCell) -> Td:
    found = math.isfinite(cell.median)
    return Td(escape(cell.text), cell.median if found else None, "number" if found else "number failure")


def _front(plot: Plot) -> str:
    if not plot.front:
        return "<p>No Pareto front: a seed of every row failed.</p>"
    headings = [Th("from"), Th("to"), Th("held by", words=True), Th(f"{plot.score.label} there"), Th("until")]
    rows = []
    for span in spans(plot.front):
        (start, low), (end, high) = span.first, span.last
        rows.append(
            [
                number_cell(start, seconds_text(start)),
                number_cell(end, seconds_text(end)),
                text_cell(plot.series[span.series].name),
                number_cell(low, plot.score.text(low)),
                number_cell(high, plot.score.text(high)),
            ]
        )
    return table(headings, rows, f"Pareto front of {title(plot)}: who is best at which training time", left=0)
