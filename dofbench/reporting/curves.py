"""Score against training time as pictures: one for each dataset, protocol and score."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from dofbench.evaluation.figures import NEUTRAL, Look, file_name, look, new_figure, save
from dofbench.reporting.plots import Plot
from dofbench.reporting.series import Series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLOTTED = ("psnr", "ssim", "aif_psnr", "aif_ssim", "photo_psnr", "across_psnr", "delta_a", "delta_f", "delta_r")
FRONT_LABEL = "Pareto front"
_LEGEND_WIDTH = 95  # characters of a legend in one column
_LEGEND_LINE = 0.16  # inches
_MANY = 7  # series, above which the legend has several columns and a seed no line of its own
_COLUMN_WIDTH = 46  # of the legend of many, characters at most
_SWATCH = 9  # characters that a line's example and its space take beside a label


def write_curves(folder: Path, plots: Iterable[Plot]) -> dict[tuple[tuple[str, ...], str], list[Path]]:
    """Draw the plots of the scores in `PLOTTED`. Returns (board, score) -> [svg, png]."""
    written = {}
    for plot in plots:
        if plot.column not in PLOTTED:
            continue
        figure = _figure(plot)
        stem = file_name(plot.dataset, plot.protocol, plot.column)
        paths = [folder / f"{stem}{suffix}" for suffix in (".svg", ".png")]
        for path in paths:
            save(figure, path)
        written[plot.board, plot.column] = paths
    return written


def _figure(plot: Plot) -> Figure:
    from matplotlib.ticker import LogLocator, NullFormatter

    many = len(plot.series) > _MANY
    labels = [_wrapped(_label(series), _COLUMN_WIDTH if many else _LEGEND_WIDTH) for series in plot.series]
    lines = sum(label.count("\n") + 1 for label in labels) + (len(plot.front) > 1) + (plot.nothing is not None)
    longest = max(len(line) for label in labels for line in label.split("\n"))
    columns = max(1, _LEGEND_WIDTH // (longest + _SWATCH)) if many else 1
    figure = new_figure(7.0, 3.9 + _LEGEND_LINE * math.ceil(lines / columns))
    axes = figure.add_subplot()
    if len(plot.front) > 1:  # drawn below the curves, so that it hides none of them
        axes.step(
            [point.time for point in plot.front],
            [point.score for point in plot.front],
            where="post",
            color=NEUTRAL,
            alpha=0.3,
            linewidth=6,
            solid_capstyle="butt",
            label=FRONT_LABEL,
        )
    for series, label in zip(plot.series, labels, strict=True):
        _draw(axes, series, label, look(series.place), seeds=not many)
    if plot.nothing is not None:
        axes.axhline(plot.nothing, color=NEUTRAL, linestyle=(0, (1, 3)), label="do nothing")
    axes.set_xscale("log")
    axes.set_xlabel("training time [s]")
    axes.set_ylabel(plot.score.heading)
    axes.set_title(plot.title)
    axes.grid(True, which="both", alpha=0.3)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(NullFormatter())  # between them labels would overlap
    # Below the plot, since options can make a label longer than the plot is wide; its lines are long enough to tell
    # dashes from dots and dashes.
    figure.legend(fontsize=8, loc="outside lower left", ncols=columns, handlelength=3.5)
    return figure


def _label(series: Series) -> str:
    seeds = f", median of {len(series.runs)} seeds" if _several(series) else ""
    return series.label + (f" ({series.failures})" if series.failures else "") + seeds


def _wrapped(label: str, width: int) -> str:
    return "\n".join(textwrap.wrap(label, width, subsequent_indent="  "))


def _several(series: Series) -> bool:
    return len(series.runs) > 1 and bool(series.median)


def _draw(axes: Axes, series: Series, label: str, style: Look, *, seeds: bool) -> None:
    """Draw one run as its scored moments; several runs as thin lines, if `seeds`, and their median as a step function,
    because no score is interpolated."""
    several = _several(series)
    unnamed = not several  # one label per series: matplotlib leaves labels with an underscore out of the legend
    for run in series.runs:
        if not run.points or (several and not seeds):
            continue
        thin = {"linewidth": 0.8, "alpha": 0.5, "markersize": 2} if several else {"markersize": 3}
        axes.plot(*zip(*run.points, strict=True), label=label if unnamed else "_seed", marker="o", **thin, **style)
        unnamed = False
    if several:
        axes.step(*zip(*series.median, strict=True), where="post", label=label, linewidth=2, **style)
