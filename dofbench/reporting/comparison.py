"""A strip of pictures: the truth, every method's prediction and its error, for one test view."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError, Status
from dofbench.core.images import read_image
from dofbench.reporting.figures import new_figure, save
from dofbench.reporting.truth_images import find_dataset, prediction_file, true_picture
from dofbench.results.collecting import Entry, grouped
from dofbench.results.columns import COLUMNS
from dofbench.scoring.error_maps import FULL_SCALE
from dofbench.scoring.evaluate import PREFIX, Kind

_TITLES: dict[Kind, str] = {
    "refocus": "through the true lens",
    "all_in_focus": "all in focus",
    "photograph": "as photographed",
    "across": "at the other aperture",
}
_PANEL = 2.6  # inches wide


def write_strip(path: Path, entries: list[Entry], names: dict[tuple[str, ...], tuple[str, str]]) -> str | None:
    """Write the strip of one board as PNG: the first test view, the first seed of every variant.

    Returns None when it was written, else one line that says why it couldn't be.
    """
    shown = [
        (names[variant], good[0])
        for variant, seeds in grouped(entries, "variant").items()
        if (
            good := [
                entry
                for entry in seeds
                if entry.status is Status.OK
                and entry.result
                and any(name.split("/")[1] in PREFIX for name in entry.result.predictions)
            ]
        )
    ]
    if not shown:
        return "no run has predictions"
    dataset, trouble = find_dataset(entry for _, entry in shown)
    if dataset is None:
        return trouble
    view = next(view for view in dataset.views if view.split == "test")
    kinds = [kind for kind in PREFIX if any(prediction_file(entry, kind, view.name) for _, entry in shown)]
    if not kinds:
        return "the predictions aren't beside the results"
    height = _PANEL * view.camera.height / view.camera.width
    figure = new_figure(_PANEL * (1 + len(shown)), (2 * height + 0.7) * len(kinds) + 0.4)
    grid = figure.subplots(2 * len(kinds), 1 + len(shown), squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for index, kind in enumerate(kinds):
        try:
            truth = true_picture(dataset, kind, view)
        except InputError as error:
            return str(error)
        upper, lower = grid[2 * index], grid[2 * index + 1]
        _show(upper[0], truth, f"truth, {_TITLES[kind]}")
        lower[0].text(
            0.5,
            0.5,
            f"this row: mean absolute error,\nblack 0, lightest {FULL_SCALE} or more",
            ha="center",
            va="center",
            fontsize=8,
            transform=lower[0].transAxes,
        )
        for column, ((method, preset), entry) in enumerate(shown, start=1):
            picture = prediction_file(entry, kind, view.name)
            if picture is None:
                reason = entry.left_out.get(f"{PREFIX[kind]}psnr", "the picture isn't beside the result")
                upper[column].text(
                    0.5,
                    0.5,
                    textwrap.fill(f"{method} {preset}: {reason}", 28),
                    ha="center",
                    va="center",
                    fontsize=8,
                    transform=upper[column].transAxes,
                )
                continue
            psnr = next(
                scored.scores[f"{PREFIX[kind]}psnr"] for scored in entry.result.views if scored.name == view.name
            )
            _show(upper[column], read_image(picture), f"{method} {preset}\n{COLUMNS['psnr'].text(psnr)} dB")
            error = prediction_file(entry, f"{kind}_error", view.name)
            if error is not None:
                _show(lower[column], read_image(error), "")
    figure.suptitle(f"{dataset.name}, view {view.name}, {entries[0].spec.protocol}", fontsize=10)
    save(figure, path)
    return None


def _show(axes, image: np.ndarray, title: str) -> None:
    axes.imshow(image, vmin=0, vmax=1, interpolation="nearest")
    axes.set_title(title, fontsize=8)
