"""A strip of pictures: the truth, every method's prediction and its error, for one test view."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import read_image
from dofbench.evaluation.figures import new_figure, save
from dofbench.evaluation.scoring.error_maps import FULL_SCALE
from dofbench.reporting.gallery import BoardPictures, RunPictures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANEL = 2.6  # width of a panel, inches
_ACROSS = 6  # panels in a line
_LINE, _TITLE = 28, 40  # characters per line of a text in place of a picture, and above a picture
_OF_ERRORS = f"this row: mean absolute error,\nblack 0, lightest {FULL_SCALE} or more"


@dataclass(frozen=True, eq=False)
class _Panel:
    """A picture and its title, or words in its place; below it its error, or words."""

    image: np.ndarray | None
    title: str
    error: np.ndarray | None
    below: str


def write_strip(path: Path, pictures: BoardPictures) -> str | None:
    """Write the strip of one board as PNG: its first test view that has pictures. The runs of a kind stand in lines of
    `_ACROSS` panels, the best first; a run without a picture of any kind has its reason instead.

    Returns None when the strip was written, else one line with the reason.
    """
    if not pictures.views:
        return pictures.trouble
    view = pictures.views[0]
    nowhere = {run.name for run in view.kinds[0].runs} - {
        run.name for kind in view.kinds for run in kind.runs if run.picture
    }
    lines: list[list[_Panel]] = []
    height, width = 1, 1
    for kind in view.kinds:
        if kind.truth is None:
            return kind.reason
        try:
            truth = kind.truth.read()
        except InputError as error:
            return str(error)
        height, width = truth.shape[:2]
        panels = [_Panel(truth, f"truth, {kind.title}", None, _OF_ERRORS)]
        panels += [_panel(run) for run in sorted(kind.runs, key=_rank) if run.picture or run.name in nowhere]
        lines += [panels[start : start + _ACROSS] for start in range(0, len(panels), _ACROSS)]
    columns = max(map(len, lines))
    figure = new_figure(_PANEL * columns, (2 * _PANEL * height / width + 0.7) * len(lines) + 0.4)
    grid = figure.subplots(2 * len(lines), columns, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for index, line in enumerate(lines):
        for upper, lower, panel in zip(grid[2 * index], grid[2 * index + 1], line, strict=False):
            _draw(upper, panel.image, panel.title)
            _draw(lower, panel.error, panel.below)
    figure.suptitle(f"{pictures.board}, view {view.name}", fontsize=10)
    save(figure, path)
    return None


def _panel(run: RunPictures) -> _Panel:
    if run.picture is None:
        return _Panel(None, textwrap.fill(f"{run.name}: {run.reason}", _LINE), None, "")
    score = "".join(f"{heading} {value}" for heading, value in run.scores[:1])
    error = None if run.error is None else read_image(run.error)
    return _Panel(read_image(run.picture), f"{run.name}\n{score}", error, "")


def _rank(run: RunPictures) -> tuple[bool, float]:
    """By what runs are put in order: the first score, which is a PSNR, the best first; then those without one."""
    value = float(run.scores[0][1]) if run.scores else math.nan
    return math.isnan(value), -value


def _draw(axes: Axes, image: np.ndarray | None, words: str) -> None:
    """An image with the words above it, or the words in its place."""
    if image is None:
        axes.text(0.5, 0.5, words, ha="center", va="center", fontsize=8, transform=axes.transAxes)
        return
    axes.imshow(image, vmin=0, vmax=1, interpolation="nearest")
    axes.set_title("\n".join(textwrap.fill(line, _TITLE) for line in words.splitlines()), fontsize=8)
