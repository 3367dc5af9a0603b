"""Figures of a report: score against training time, and strips of truth, predictions and errors."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import read_image
from dofbench.evaluation.figures import NEUTRAL, Look, file_name, look, new_figure, save
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.reporting.curves import Plot, Series
from dofbench.reporting.pictures import BoardPictures, RunPictures

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLOTTED = ("psnr", "ssim", "aif_psnr", "aif_ssim", "photo_psnr", "across_psnr", "delta_a", "delta_f", "delta_r")
_LEGEND_WIDTH = 95  # characters of a legend in one column
_LEGEND_LINE = 0.16  # inches
_MANY = 7  # series, above which the legend has several columns and a seed no line of its own
_COLUMN_WIDTH = 46  # of the legend of many, characters at most
_SWATCH = 9  # characters that a line's example and its space take next to a label

_PANEL = 2.6  # width of a panel of a strip, inches
_ACROSS = 6  # panels in a line
_LINE, _TITLE = 28, 40  # characters per line of a text in place of a picture, and above a picture
OF_ERRORS = f"this row: mean absolute error,\nblack 0, lightest {FULL_SCALE} or more"


# ---- curves ----


def write_curves(folder: Path, plots: Iterable[Plot]) -> dict[tuple[tuple[str, ...], str], list[Path]]:
    """Draw the plots of the scores in `PLOTTED`. Returns (board, score) -> [svg, png]."""
    written = {}
    for plot in plots:
        if plot.column not in PLOTTED:
            continue
        figure = draw_plot(plot)
        stem = file_name(plot.in_files or plot.dataset, plot.protocol, plot.column)
        paths = [folder / f"{stem}{suffix}" for suffix in (".svg", ".png")]
        for path in paths:
            save(figure, path)
        written[plot.board, plot.column] = paths
    return written


def draw_plot(plot: Plot) -> Figure:
    """Draw the curves, the Pareto front and the line of a predictor that learns nothing over log time."""
    from matplotlib.ticker import LogLocator, NullFormatter

    many = len(plot.series) > _MANY
    width = _COLUMN_WIDTH if many else _LEGEND_WIDTH
    labels = ["\n".join(textwrap.wrap(_label(one), width, subsequent_indent="  ")) for one in plot.series]
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
            label="Pareto front",
        )
    for series, label in zip(plot.series, labels, strict=True):
        _draw(axes, series, label, look(series.place), seeds=not many)
    if plot.nothing is not None:
        axes.axhline(plot.nothing, color=NEUTRAL, linestyle=(0, (1, 3)), label="do nothing")
    axes.set_xscale("log")
    axes.set_xlabel(f"{plot.clock} [s]")
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


# ---- strips ----


@dataclass(frozen=True, eq=False)
class Panel:
    """A picture and its title, or the title in its place; below it its error, or words."""

    image: np.ndarray | None
    title: str
    error: np.ndarray | None = None
    below: str = ""


def write_strip(path: Path, pictures: BoardPictures) -> str | None:
    """Write the strip of one board as PNG: its first test view that has pictures. Returns None when it was written,
    else one line with the reason."""
    if not pictures.views:
        return pictures.trouble
    try:
        lines = strip_lines(pictures)
    except InputError as error:
        return str(error)
    if isinstance(lines, str):
        return lines
    height, width = next(panel.image.shape for panel in lines[0] if panel.image is not None)[:2]
    columns = max(map(len, lines))
    figure = new_figure(_PANEL * columns, (2 * _PANEL * height / width + 0.7) * len(lines) + 0.4)
    grid = figure.subplots(2 * len(lines), columns, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for index, line in enumerate(lines):
        for upper, lower, panel in zip(grid[2 * index], grid[2 * index + 1], line, strict=False):
            _draw_panel(upper, panel.image, panel.title)
            _draw_panel(lower, panel.error, panel.below)
    figure.suptitle(f"{pictures.board}, view {pictures.views[0].name}", fontsize=10)
    save(figure, path)
    return None


def strip_lines(pictures: BoardPictures) -> list[list[Panel]] | str:
    """The panels of a board's first test view in lines of `_ACROSS`: of each kind the truth and the runs, best first; a
    run without a picture of any kind has its reason instead. The reason instead, if a truth is missing. Raises
    InputError when a truth can't be read."""
    kinds = pictures.views[0].kinds
    nowhere = {run.name for run in kinds[0].runs} - {run.name for kind in kinds for run in kind.runs if run.picture}
    lines: list[list[Panel]] = []
    for kind in kinds:
        if kind.truth is None:
            return kind.reason
        panels = [Panel(read_image(kind.truth), f"truth, {kind.title}", below=OF_ERRORS)]
        panels += [_panel(run) for run in kind.best_first if run.picture or run.name in nowhere]
        lines += [panels[start : start + _ACROSS] for start in range(0, len(panels), _ACROSS)]
    return lines


def _panel(run: RunPictures) -> Panel:
    if run.picture is None:
        return Panel(None, textwrap.fill(f"{run.name}: {run.reason}", _LINE))
    score = "".join(f"{heading} {value}" for heading, value in run.scores[:1])
    return Panel(read_image(run.picture), f"{run.name}\n{score}", None if run.error is None else read_image(run.error))


def _draw_panel(axes: Axes, image: np.ndarray | None, words: str) -> None:
    """Draw an image with the words above it, or the words in its place."""
    if image is None:
        axes.text(0.5, 0.5, words, ha="center", va="center", fontsize=8, transform=axes.transAxes)
        return
    axes.imshow(image, vmin=0, vmax=1, interpolation="nearest")
    axes.set_title("\n".join(textwrap.fill(line, _TITLE) for line in words.splitlines()), fontsize=8)
