"""Error against run time in words and rows: time to reach a score, and who holds the Pareto front."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from dofbench.reporting.footnotes import table
from dofbench.reporting.line_table import plain
from dofbench.reporting.pareto import spans
from dofbench.reporting.plots import Plot
from dofbench.reporting.reach import LEVEL_RULE, level_text, reach_cell, run_reached, seconds_text
from dofbench.reporting.table_files import write_csv

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
)
FRONT_COLUMNS = ("dataset", "protocol", "score", "train_s", "value", "method", "preset")


def timing_lines(plot: Plot) -> list[str]:
    """Below a plot: the front in a line, and the table of times to reach the levels."""
    lines = [front_line(plot), ""] if plot.front else []
    if plot.levels:
        heading = ["time to reach", *(level_text(plot.column, level) for level in plot.levels)]
        rows = [
            [
                plain(series.name),
                *(reach_cell(series, level, higher_is_better=plot.higher_is_better).text for level in plot.levels),
            ]
            for series in plot.series
        ]
        lines += [*table(heading, rows, left=1), ""]
    return lines


def level_words(plots: Iterable[Plot]) -> str:
    """How the levels came about."""
    chosen = any(plot.chosen for plot in plots)
    return f"{LEVEL_RULE}; where `--reach` gave levels, they are those." if chosen else f"{LEVEL_RULE}."


def front_line(plot: Plot) -> str:
    """As "Pareto front: A from 0.2 s (12.1 dB), B from 31 s (25.0 dB) to 412 s (31.2 dB)."."""
    held = spans(plot.front)
    unit = f" {plot.score.unit}" if plot.score.unit else ""
    parts = [
        f"{plain(plot.series[span.series].name)} from {seconds_text(span.first[0])} "
        f"({plot.score.text(span.first[1])}{unit})"
        for span in held
    ]
    end = held[-1].last
    until = "" if end == held[-1].first else f" to {seconds_text(end[0])} ({plot.score.text(end[1])}{unit})"
    return f"Pareto front: {', '.join(parts)}{until}."


def write_reach_csv(path: Path, plots: Iterable[Plot]) -> None:
    """One row for every run and level. reached_s is empty where the level wasn't reached; the true time lies between
    not_before_s and reached_s."""
    write_csv(path, REACH_COLUMNS, (row for plot in plots for row in _reach_rows(plot)))


def write_front_csv(path: Path, plots: Iterable[Plot]) -> None:
    """One row for every point of every front."""
    rows = (
        {
            "dataset": plot.dataset,
            "protocol": plot.protocol,
            "score": plot.column,
            "train_s": point.time,
            "value": point.score,
            "method": plot.series[point.series].method,
            "preset": plot.series[point.series].preset,
        }
        for plot in plots
        for point in plot.front
    )
    write_csv(path, FRONT_COLUMNS, rows)


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
                }
