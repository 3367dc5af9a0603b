"""Plot of error against run time: one panel for each source of truth and region, one line for each renderer with a
quality setting."""

from __future__ import annotations

from pathlib import Path

from dofbench.evaluation.figures import look, new_figure, save
from dofbench.evaluation.renderer.regions import REGIONS
from dofbench.evaluation.renderer.renderer_scores import Score
from dofbench.evaluation.renderer.renderer_tables import mean_psnr, seconds
from dofbench.evaluation.renderer.variants import VARIANTS

_PLOTTED = tuple(region for region in REGIONS if region != "frame")
_LEAST_RANGE = 1.0  # dB: smallest range of an axis, so that tiny differences aren't magnified
_MARKERS = {"scatter": "D", "layered": "o", "thinlens": "s"}


def plot_precision(rows: list[Score], folder: Path) -> Path:
    """Write precision.png into the folder and return its path."""
    sources = list(dict.fromkeys(row.source for row in rows))
    families = list(dict.fromkeys(variant.family for variant in VARIANTS if variant.family))
    figure = new_figure(3.2 * len(_PLOTTED), 2.6 * len(sources) + 0.6)
    panels = figure.subplots(len(sources), len(_PLOTTED), squeeze=False, sharex=True)
    for line, source in zip(panels, sources, strict=True):
        line[0].set_ylabel(f"{source}\nPSNR [dB]")
        for axes, region in zip(line, _PLOTTED, strict=True):
            for index, family in enumerate(families):
                points = _points(rows, source, region, family)
                if points:
                    times, errors, knobs = zip(*points, strict=True)
                    axes.plot(times, errors, label=family, marker=_MARKERS[family], markersize=4, **look(index))
                    for time, error, knob in points:
                        if knob in (min(knobs), max(knobs)) and knob:
                            axes.annotate(
                                str(knob), (time, error), textcoords="offset points", xytext=(3, 4), fontsize=7
                            )
            axes.set_xscale("log")
            middle, half = sum(axes.get_ylim()) / 2, (axes.get_ylim()[1] - axes.get_ylim()[0]) / 2
            axes.set_ylim(middle - max(half, _LEAST_RANGE), middle + max(half, _LEAST_RANGE))
            axes.set_title(region, fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("seconds a megapixel")
    labelled = max(panels.flat, key=lambda axes: len(axes.get_legend_handles_labels()[0]))
    figure.legend(*labelled.get_legend_handles_labels(), loc="outside upper center", ncols=len(families))
    path = folder / "precision.png"
    save(figure, path)
    return path


def _points(rows: list[Score], source: str, region: str, family: str) -> list[tuple[float, float, int]]:
    """(seconds a megapixel, mean PSNR, knob) of a family's renderers that have scores there."""
    points = []
    for variant in VARIANTS:
        chosen = [row for row in rows if row.variant == variant.name and row.source == source and row.region == region]
        mean = mean_psnr(chosen)
        if variant.family == family and mean is not None:
            points.append((seconds(chosen), mean, variant.knob))
    return points
