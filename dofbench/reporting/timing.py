"""Error against run time: the Pareto front and times to reach a score, as parts of the page and as CSV records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from dofbench.core.evidence import ROLE_NOT_STATED
from dofbench.reporting import standing, table_cells
from dofbench.reporting.pareto import spans
from dofbench.reporting.plots import Plot
from dofbench.reporting.reach import LEVEL_RULE, RULE, level_text, reach_cell, run_reached, seconds_text
from dofbench.reporting.records import Records
from dofbench.reporting.report_view import CurveView
from dofbench.reporting.view import Cell, Heading, Paragraph, Picture, Table

TIME_RULE = "Training time is wall time with the clock stopped while scoring; compiling kernels isn't in it"
FRONT_RULE = (
    "The Pareto front holds the scored moments (medians over seeds) that no other method or preset beats: none is as "
    "early and as good"
)
REACH_COLUMNS = (
    "method",
    "preset",
    "dataset",
    "scene",
    "protocol",
    "seed",
    "score",
    "level",
    "reached_s",
    "not_before_s",
    "held",
    "status",
    "role",
)
FRONT_COLUMNS = ("dataset", "protocol", "score", "train_s", "value", "method", "preset", "role")


def curve_view(plot: Plot, picture: Picture | None) -> CurveView:
    """A plot with the tables below it: the Pareto front, and the times to reach its levels."""
    title = f"{plot.score.label} on {plot.dataset}, {plot.protocol}"
    front = plot.front
    return CurveView(
        title,
        plot,
        picture,
        _front_words(plot) if front else "",
        _reach_table(plot, title) if plot.levels else None,
        _front_table(plot, title) if front else None,
    )


def curve_rules(plots: Iterable[Plot]) -> Paragraph:
    """A paragraph that explains times, levels and fronts."""
    chosen = any(plot.chosen for plot in plots)
    levels = f"{LEVEL_RULE}; where `--reach` gave levels, they are those." if chosen else f"{LEVEL_RULE}."
    return Paragraph(f"{TIME_RULE}. {RULE} {levels} {FRONT_RULE}.")


def _front_words(plot: Plot) -> str:
    """A sentence such as "Pareto front: A from 0.2 s (12.1 dB), B from 31 s (25.0 dB) to 412 s (31.2 dB)."."""
    held = spans(plot.front)
    unit = f" {plot.score.unit}" if plot.score.unit else ""
    parts = [
        f"{table_cells.signed(series.name, series.signs)} from {seconds_text(span.first[0])} "
        f"({plot.score.text(span.first[1])}{unit})"
        for span in held
        if (series := plot.series[span.series])
    ]
    end = held[-1].last
    until = "" if end == held[-1].first else f" to {seconds_text(end[0])} ({plot.score.text(end[1])}{unit})"
    return f"Pareto front: {', '.join(parts)}{until}."


def _reach_table(plot: Plot, title: str) -> Table:
    headings = (
        Heading("time to reach", words=True),
        *(Heading(level_text(plot.column, level)) for level in plot.levels),
    )
    rows = []
    for series in plot.series:
        cells = [reach_cell(series, level, higher_is_better=plot.higher_is_better) for level in plot.levels]
        rows.append(
            (
                table_cells.words(series.name, series.signs),
                *(Cell(cell.text, "number", cell.median if math.isfinite(cell.median) else None) for cell in cells),
            )
        )
    below = standing.notes(series.signs for series in plot.series)
    return Table(f"Training time to reach a score: {title}", headings, tuple(rows), below=below)


def _front_table(plot: Plot, title: str) -> Table:
    headings = (
        Heading("from"),
        Heading("to"),
        Heading("held by", words=True),
        Heading(f"{plot.score.label} there"),
        Heading("until"),
    )
    rows = []
    for span in spans(plot.front):
        (start, low), (end, high) = span.first, span.last
        rows.append(
            (
                table_cells.number(start, seconds_text(start)),
                table_cells.number(end, seconds_text(end)),
                table_cells.words(plot.series[span.series].name, plot.series[span.series].signs),
                table_cells.number(low, plot.score.text(low)),
                table_cells.number(high, plot.score.text(high)),
            )
        )
    caption = f"Pareto front of {title}: who is best at which training time"
    below = standing.notes(plot.series[span.series].signs for span in spans(plot.front))
    return Table(caption, headings, tuple(rows), names=0, below=below)


def reach_records(plots: Iterable[Plot]) -> Records:
    """One row for every run and level. reached_s is empty if the level wasn't reached; the true time lies between
    not_before_s and reached_s."""
    return Records("reach.csv", REACH_COLUMNS, tuple(row for plot in plots for row in _reach_rows(plot)))


def front_records(plots: Iterable[Plot]) -> Records:
    """One row for every point of every front."""
    rows = tuple(
        {
            "dataset": plot.dataset,
            "protocol": plot.protocol,
            "score": plot.column,
            "train_s": point.time,
            "value": point.score,
            "method": plot.series[point.series].method,
            "preset": plot.series[point.series].preset,
            "role": plot.role or ROLE_NOT_STATED,
        }
        for plot in plots
        for point in plot.front
    )
    return Records("pareto.csv", FRONT_COLUMNS, rows)


def _reach_rows(plot: Plot) -> Iterator[dict[str, object]]:
    for series in plot.series:
        for run in series.runs:
            for level in plot.levels:
                found = run_reached(run, level, higher_is_better=plot.higher_is_better)
                yield {
                    "method": series.method,
                    "preset": series.preset,
                    "dataset": plot.dataset,
                    "scene": plot.scene,
                    "protocol": plot.protocol,
                    "seed": run.seed,
                    "score": plot.column,
                    "level": level,
                    "reached_s": found.time,
                    "not_before_s": None if found.time is None else found.before,
                    "held": "" if found.time is None else "yes" if found.held else "no",
                    "status": str(run.status),
                    "role": plot.role or ROLE_NOT_STATED,
                }
