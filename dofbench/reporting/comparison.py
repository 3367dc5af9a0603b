"""A strip of pictures: the truth, every method's prediction and its error, for one test view."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import read_image
from dofbench.reporting.figures import new_figure, save
from dofbench.reporting.gallery import BoardPictures, KindPictures
from dofbench.scoring.error_maps import FULL_SCALE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PANEL = 2.6  # width of a panel, inches
_LINE, _TITLE = 28, 40  # characters per line of a text in place of a picture, and above a picture


def write_strip(path: Path, pictures: BoardPictures) -> str | None:
    """Write the strip of one board as PNG: its first test view that has pictures.

    Returns None when the strip was written, else one line with the reason.
    """
    if not pictures.views:
        return pictures.trouble
    view = pictures.views[0]
    truths: list[np.ndarray] = []
    for kind in view.kinds:
        if kind.truth is None:
            return kind.reason
        try:
            truths.append(kind.truth.read())
        except InputError as error:
            return str(error)
    columns = 1 + len(view.kinds[0].runs)
    height, width = truths[0].shape[:2]
    figure = new_figure(_PANEL * columns, (2 * _PANEL * height / width + 0.7) * len(view.kinds) + 0.4)
    grid = figure.subplots(2 * len(view.kinds), columns, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for index, (kind, truth) in enumerate(zip(view.kinds, truths, strict=True)):
        _draw(grid[2 * index], grid[2 * index + 1], kind, truth)
    figure.suptitle(f"{pictures.board}, view {view.name}", fontsize=10)
    save(figure, path)
    return None


def _draw(upper: Sequence[Axes], lower: Sequence[Axes], kind: KindPictures, truth: np.ndarray) -> None:
    """One kind of prediction: pictures above, their errors below."""
    _show(upper[0], truth, f"truth, {kind.title}")
    _say(lower[0], f"this row: mean absolute error,\nblack 0, lightest {FULL_SCALE} or more")
    for place, run in enumerate(kind.runs, start=1):
        if run.picture is None:
            _say(upper[place], textwrap.fill(f"{run.name}: {run.reason}", _LINE))
            continue
        score = "".join(f"{heading} {value}" for heading, value in run.scores[:1])
        _show(upper[place], read_image(run.picture), f"{run.name}\n{score}")
        if run.error is not None:
            _show(lower[place], read_image(run.error), "")


def _show(axes: Axes, image: np.ndarray, title: str) -> None:
    axes.imshow(image, vmin=0, vmax=1, interpolation="nearest")
    axes.set_title("\n".join(textwrap.fill(line, _TITLE) for line in title.splitlines()), fontsize=8)


def _say(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, ha="center", va="center", fontsize=8, transform=axes.transAxes)
