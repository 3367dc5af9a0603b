"""Score against training time as pictures: one for each dataset, protocol and score."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dofbench.reporting.figures import NEUTRAL, file_name, look, new_figure, save
from dofbench.reporting.plots import Plot
from dofbench.reporting.series import Series

PLOTTED = ("psnr", "ssim", "aif_psnr", "aif_ssim", "delta_a", "delta_f")
FRONT_LABEL = "Pareto front"


def write_curves(folder: Path, plots: Iterable[Plot]) -> dict[tuple[str, ...], dict[str, list[Path]]]:
    """Draw the plots of the scores in `PLOTTED`. Returns board -> score -> [svg, png]."""
    written: dict[tuple[str, ...], dict[str, list[Path]]] = {}
    for plot in plots:
        if plot.column not in PLOTTED:
            continue
        figure = _figure(plot)
        stem = file_name(plot.dataset, plot.protocol, plot.column)
        paths = [folder / f"{stem}{suffix}" for suffix in (".svg", ".png")]
        for path in paths:
            save(figure, path)
        written.setdefault(plot.board, {})[plot.column] = paths
    return written


def _figure(plot: Plot):
    figure = new_figure(7.0, 4.2)
    axes = figure.add_subplot()
    if len(plot.front) > 1:  # below the curves, so that it hides none
        axes.step([point.time for point in plot.front], [point.score for point in plot.front], where="post",
                  color=NEUTRAL, alpha=0.3, linewidth=6, solid_capstyle="butt", label=FRONT_LABEL)
    for index, series in enumerate(plot.series):
        _draw(axes, series, look(index))
    if plot.nothing is not None:
        axes.axhline(plot.nothing, color=NEUTRAL, linestyle=(0, (1, 3)), label="do nothing")
    axes.set_xscale("log")
    axes.set_xlabel("training time [s]")
    axes.set_ylabel(plot.score.heading)
    axes.set_title(f"{plot.dataset}, {plot.protocol}")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def _draw(axes, series: Series, style: dict[str, str]) -> None:
    """A run as its scored moments; several as thin lines and their median, which is a step as no score is
    interpolated."""
    label = series.name + (f" ({series.failures})" if series.failures else "")
    several = len(series.runs) > 1 and bool(series.median)
    for run in series.runs:
        if not run.points:
            continue
        thin = {"linewidth": 0.8, "alpha": 0.5, "markersize": 2} if several else {"markersize": 3}
        axes.plot(*zip(*run.points, strict=True), label="_seed" if several else label, marker="o", **thin, **style)
        label = "_another seed"  # matplotlib leaves labels with an underscore out of the legend
    if several:
        label = f"{series.name}, median of {len(series.runs)} seeds"
        axes.step(*zip(*series.median, strict=True), where="post", label=label, linewidth=2, **style)
