"""The scores as renderer.csv, renderer.md and precision.png."""

from __future__ import annotations

import csv
import io
import itertools
import math
import os
import shlex
from collections.abc import Callable, Iterable
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.core.markdown_text import code
from dofbench.evaluation.figures import look, new_figure, save
from dofbench.evaluation.renderer.renderer_scores import REGIONS, Score
from dofbench.evaluation.renderer.validation_options import ValidateRenderer
from dofbench.evaluation.renderer.variants import VARIANTS, Variant

EXACT_DB = 100.0  # PSNR in means for a region without any error
_BY_SCENE = ("no blur", "scatter", "layered, 4", "layered, 16", "thinlens, 64")
_WHAT = {
    "planes": "textured planes in front of an exact thin lens, exact depth.",
    "planes, hexagonal aperture": 'the same planes, aperture with six blades. "Other aperture" is a disc here.',
    "light field": "views of a real light field, summed over a round aperture; disparity by a plane sweep, whose "
    "errors are part of every renderer's.",
    "rendered": "scenes by `dofbench make-scene` rendered with a thin-lens camera, exact depth, linear light with "
    "highlights above white.",
    "BLB": "Blender scenes with depth and bokeh images, BokehMe's benchmark; its protocol scores the whole frame.",
}
_PAPER = (
    "DoF-Gaussian reports 43.30 dB / 0.9932 for the pipeline of its synthetic set, on other scenes rendered with "
    "Blender."
)
_QUOTED_AT = ("rendered", "BLB")
_PLOTTED = tuple(region for region in REGIONS if region != "frame")
_LEAST_RANGE = 1.0  # dB: smallest range of an axis, so that tiny differences aren't magnified
_MARKERS = {"scatter": "D", "layered": "o", "thinlens": "s"}

Cell = Callable[[list[Score]], str]


def csv_text(rows: Iterable[Score]) -> str:
    """One line per score, with eight digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in fields(Score)])
    for row in rows:
        writer.writerow([f"{value:.8g}" if isinstance(value, float) else value for value in asdict(row).values()])
    return text.getvalue()


def markdown(rows: list[Score], cases: int, settings: ValidateRenderer, plots: list[Path]) -> str:
    """The report. cases: number of images to score."""
    scored = _images(rows)
    words = ["dofbench", "validate-renderer", *(folder.name for folder in settings.truths)]
    command = code(shlex.join(words + ([] if settings.planes else ["--no-planes"])))
    lines = ["# Renderers compared with optical blur", "", command, ""]
    if scored < cases:
        lines += [f"Unfinished: {scored} of {cases} images. Rerun the same command to resume.", ""]
    lines += [
        "Means over images: PSNR in dB / SSIM / FLIP of encoded images in [0, 1]. Depth edge: within one CoC radius of "
        "a jump in depth. Frame: the whole image; the other regions exclude a margin as wide as the blur, which light "
        f"from outside the image reaches. Exact regions count as {EXACT_DB:.0f} dB. Seconds are medians for one "
        f"megapixel{_load()}.",
        "",
    ]
    lines += [line for plot in plots for line in (f"![Error against run time, by region]({plot.name})", "")]
    for source in dict.fromkeys(row.source for row in rows):
        lines += _source(source, [row for row in rows if row.source == source])
    return "\n".join(lines)


def _source(source: str, rows: list[Score]) -> list[str]:
    found = _by_variant(rows)
    fastest = sorted((variant for variant in found if variant.family), key=lambda variant: _seconds(found[variant]))
    every, some = ({variant.name: found[variant] for variant in chosen} for chosen in (found, fastest))
    time: dict[str, Cell] = {"s a megapixel": lambda rows: f"{_seconds(rows):.2g}"}
    full: dict[str, Cell] = {region: partial(_in_region, _scores, region) for region in REGIONS}
    plain: dict[str, Cell] = {region: partial(_in_region, _psnr, region) for region in REGIONS}
    spans: dict[str, Cell] = {
        f"{low:.1f} to {min(high, rows_max):.1f}": partial(_in_span, low, high) for low, high, rows_max in _spans(rows)
    }
    scenes = {name: [row for row in rows if row.name == name] for name in dict.fromkeys(row.name for row in rows)}
    variants: dict[str, Cell] = {v.name: partial(_of_variant, v.name) for v in found if v.name in _BY_SCENE}
    quoted = [_PAPER, ""] if source in _QUOTED_AT else []
    return [
        *(f"## {source}", "", f"{_images(rows)} images: {_WHAT[source]} {_noise(source, rows)}", "", *quoted),
        *_table("renderer", every, full | time),
        *("", "Error against run time, fastest first: PSNR.", "", *_table("renderer", some, time | plain)),
        *("", "By the largest radius in the image, pixels: PSNR of the whole image / at depth edges.", ""),
        *_table("renderer", every, spans),
        *("", "By scene: the same.", "", *_table("scene", scenes, variants), ""),
    ]


def _table(first: str, lines: dict[str, list[Score]], columns: dict[str, Cell]) -> list[str]:
    """A Markdown table: each cell is a column's function of a line's scores."""
    return [
        f"| {first} | {' | '.join(columns)} |",
        "| --- |" + " --- |" * len(columns),
        *(f"| {name} | {' | '.join(cell(rows) for cell in columns.values())} |" for name, rows in lines.items()),
    ]


def _in_region(cell: Cell, region: str, rows: list[Score]) -> str:
    return cell([row for row in rows if row.region == region])


def _in_span(low: float, high: float, rows: list[Score]) -> str:
    return _whole_and_edge([row for row in rows if low <= row.radius < high])


def _of_variant(name: str, rows: list[Score]) -> str:
    return _whole_and_edge([row for row in rows if row.variant == name])


def _whole_and_edge(rows: list[Score]) -> str:
    return " / ".join(_in_region(_psnr, region, rows) for region in ("all", "depth edge"))


def _scores(rows: list[Score]) -> str:
    if not rows:
        return "–"
    if all(math.isinf(row.psnr) for row in rows):
        return "exact"
    ssim, flip = (float(np.mean([getattr(row, key) for row in rows])) for key in ("ssim", "flip"))
    return f"{_psnr(rows)} / {ssim:.4f} / {flip:.4f}"


def _psnr(rows: list[Score]) -> str:
    return f"{_mean_psnr(rows):.2f}" if rows else "–"


def _mean_psnr(rows: list[Score]) -> float:
    """Mean over images, dB."""
    return float(np.mean([min(row.psnr, EXACT_DB) for row in rows]))


def _seconds(rows: list[Score]) -> float:
    """Median over images of one rendering's time per megapixel."""
    return float(np.median([row.seconds_per_megapixel for row in rows]))


def _spans(rows: list[Score]) -> list[tuple[float, float, float]]:
    """Three intervals of the radius with as many images each: (from, below, largest radius)."""
    edges = np.percentile([row.radius for row in rows], [0, 100 / 3, 200 / 3, 100])
    # The last interval includes its upper end, so that it contains the largest radius.
    spans = [(low, high if high < edges[-1] else math.inf) for low, high in itertools.pairwise(edges) if low < high]
    return [(low, high, edges[-1]) for low, high in spans or [(edges[0], math.inf)]]


def _noise(source: str, rows: list[Score]) -> str:
    least = min(row.truth_psnr for row in rows)
    if math.isnan(least):
        return "Their own noise is unknown."
    if source == "rendered":
        return f"Their own noise: {least:.1f} dB or more against infinitely many rays."
    return f"Their own error: {least:.1f} dB or more between half of the aperture samples and all."


def _by_variant(rows: list[Score]) -> dict[Variant, list[Score]]:
    found = {variant: [row for row in rows if row.variant == variant.name] for variant in VARIANTS}
    return {variant: of_one for variant, of_one in found.items() if of_one}


def _images(rows: list[Score]) -> int:
    return len({(row.source, row.name, row.view, row.aperture, row.focus) for row in rows})


def _load() -> str:
    """The cores, and whether the machine was busy: only ratios of times on a busy machine are meaningful."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[2] if hasattr(os, "getloadavg") else 0.0
    busy = f", busy with other work (load {load:.0f}): only ratios of times are meaningful" if load > 2 * cores else ""
    return f", on {cores} cores{busy}"


def plot_precision(rows: list[Score], folder: Path) -> Path:
    """Plot error against run time by source and region, a line for each family of renderers, to precision.png."""
    sources = list(dict.fromkeys(row.source for row in rows))
    families = list(dict.fromkeys(variant.family for variant in VARIANTS if variant.family))
    figure = new_figure(3.2 * len(_PLOTTED), 2.6 * len(sources) + 0.6)
    panels = figure.subplots(len(sources), len(_PLOTTED), squeeze=False, sharex=True)
    for line, source in zip(panels, sources, strict=True):
        line[0].set_ylabel(f"{source}\nPSNR [dB]")
        for axes, region in zip(line, _PLOTTED, strict=True):
            found = _by_variant([row for row in rows if row.source == source and row.region == region])
            for index, family in enumerate(families):
                some = {variant.knob: of_one for variant, of_one in found.items() if variant.family == family}
                if not some:
                    continue
                points = {knob: (_seconds(of_one), _mean_psnr(of_one)) for knob, of_one in some.items()}
                axes.plot(
                    *zip(*points.values(), strict=True),
                    label=family,
                    marker=_MARKERS[family],
                    markersize=4,
                    **look(index),
                )
                for knob in {min(points), max(points)} - {0}:
                    axes.annotate(str(knob), points[knob], textcoords="offset points", xytext=(3, 4), fontsize=7)
            axes.set_xscale("log")
            middle, half = sum(axes.get_ylim()) / 2, (axes.get_ylim()[1] - axes.get_ylim()[0]) / 2
            axes.set_ylim(middle - max(half, _LEAST_RANGE), middle + max(half, _LEAST_RANGE))
            axes.set_title(region, fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("seconds a megapixel")
    labelled = max(panels.flat, key=lambda axes: len(axes.get_legend_handles_labels()[0]))
    figure.legend(*labelled.get_legend_handles_labels(), loc="outside upper center", ncols=len(families))
    save(figure, folder / "precision.png")
    return folder / "precision.png"
