"""Score against training time: one plot for each dataset, protocol and score."""

from __future__ import annotations

import math
from pathlib import Path

from dofbench.errors import Status
from dofbench.reporting.collect import Entry, grouped
from dofbench.reporting.columns import COLUMNS
from dofbench.reporting.figures import NEUTRAL, file_name, look, new_figure, save

PLOTTED = ("psnr", "aif_psnr", "delta_a", "delta_f")


def write_curves(
    folder: Path, entries: list[Entry], name: str, names: dict[tuple[str, ...], tuple[str, str]]
) -> dict[str, list[Path]]:
    """Plot the curves of one board. name: the dataset's. Returns column -> [svg, png], for the columns
    of which any run has a point."""
    written: dict[str, list[Path]] = {}
    for column in PLOTTED:
        if not any(column in point.scores for entry in entries for point in _curve(entry)):
            continue
        figure = _plot(entries, column, f"{name}, {entries[0].spec.protocol}", names)
        stem = file_name(name, entries[0].spec.protocol, column)
        written[column] = [folder / f"{stem}{suffix}" for suffix in (".svg", ".png")]
        for path in written[column]:
            save(figure, path)
    return written


def _plot(entries: list[Entry], column: str, title: str, names: dict[tuple[str, ...], tuple[str, str]]):
    figure = new_figure(7.0, 4.2)
    axes = figure.add_subplot()
    for index, (variant, seeds) in enumerate(grouped(entries, "variant").items()):
        failures = sorted({str(entry.status) for entry in seeds if entry.status is not Status.OK})
        label = " ".join(names[variant]) + (f" ({', '.join(failures)})" if failures else "")
        for entry in seeds:
            points = [(point.train_s, point.scores[column]) for point in _curve(entry)
                      if point.train_s > 0 and math.isfinite(point.scores.get(column, math.nan))]
            if points:
                axes.plot(*zip(*points, strict=True), label=label, marker="o", markersize=3, **look(index))
                label = "_another seed"  # matplotlib leaves labels with an underscore out of the legend
    nothing = next((entry.result.do_nothing[column] for entry in entries
                    if entry.result and column in entry.result.do_nothing), None)
    if nothing is not None:
        axes.axhline(nothing, color=NEUTRAL, linestyle=(0, (1, 3)), label="do nothing")
    axes.set_xscale("log")
    axes.set_xlabel("training time [s]")
    axes.set_ylabel(COLUMNS[column].heading)
    axes.set_title(title)
    axes.grid(True, which="both", alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend()
    return figure


def _curve(entry: Entry):
    return entry.result.curve if entry.result else []
