"""The scores as renderer.csv and renderer.md."""

from __future__ import annotations

import csv
import io
import itertools
import math
import os
import shlex
from collections.abc import Iterable
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from dofbench.core.markdown_text import code
from dofbench.evaluation.renderer.regions import REGIONS
from dofbench.evaluation.renderer.renderer_scores import Score
from dofbench.evaluation.renderer.validation_options import ValidateRenderer
from dofbench.evaluation.renderer.variants import VARIANTS, Variant

EXACT_DB = 100.0  # PSNR that stands in means for a region without any error
_BY_SCENE = ("no blur", "scatter", "layered, 4", "layered, 16", "thinlens, 64")
_WHAT = {
    "planes": "textured planes before an exact thin lens, depth known exactly.",
    "planes, hexagonal aperture": 'the same planes, and the lens has six blades. "Other aperture" is a disc here.',
    "light field": "views of a real light field, added over a round aperture; disparity by a plane sweep over all "
    "views, so its errors are part of every renderer's.",
    "rendered": "scenes by `dofbench make-scene` through a sampled thin lens, exact depth, linear light with "
    "highlights above white.",
    "BLB": "scenes by Blender with depth and bokeh images, BokehMe's benchmark; its protocol scores the whole frame.",
}
_PAPER = (
    "DoF-Gaussian states 43.30 dB / 0.9932 for the pipeline that made its synthetic set, on scenes rendered with "
    "Blender: other data than this, at other blur."
)
_QUOTED_AT = ("rendered", "BLB")


def csv_text(rows: Iterable[Score]) -> str:
    """One line per score, with eight digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in fields(Score)])
    for row in rows:
        writer.writerow([f"{value:.8g}" if isinstance(value, float) else value for value in asdict(row).values()])
    return text.getvalue()


def markdown(rows: list[Score], cases: int, settings: ValidateRenderer, plots: list[Path]) -> str:
    """The report; `cases`: how many photographs there are to score."""
    scored = len(_photographs(rows))
    lines = ["# How close the renderers come to optical blur", "", _command(settings), ""]
    if scored < cases:
        lines += [f"Unfinished: {scored} of {cases} photographs. The same command goes on.", ""]
    lines += [
        "Means over photographs: PSNR in dB / SSIM / FLIP of encoded images in [0, 1]. Depth edge: within one "
        "circle of confusion of a jump in depth. Frame: all of the picture; the other regions leave out a margin "
        "as wide as the blur, where light comes in from beyond the picture. Exact regions count as "
        f"{EXACT_DB:.0f} dB. Seconds are medians for one megapixel{_load()}.",
        "",
    ]
    lines += [line for plot in plots for line in (f"![Error against run time, by region]({plot.name})", "")]
    for source in dict.fromkeys(row.source for row in rows):
        lines += _source(source, [row for row in rows if row.source == source])
    return "\n".join(lines)


def mean_psnr(rows: Iterable[Score]) -> float | None:
    """Mean over photographs, dB; None without rows."""
    values = [min(row.psnr, EXACT_DB) for row in rows]
    return float(np.mean(values)) if values else None


def seconds(rows: Iterable[Score]) -> float:
    """Median over photographs of one render's time per megapixel."""
    return float(np.median([row.seconds_per_megapixel for row in rows]))


def _source(source: str, rows: list[Score]) -> list[str]:
    photographs = len(_photographs(rows))
    lines = [f"## {source}", "", f"{photographs} photographs: {_WHAT[source]} {_noise(source, rows)}", ""]
    if source in _QUOTED_AT:
        lines += [_PAPER, ""]
    lines += _table(
        "renderer",
        [*REGIONS, "s a megapixel"],
        [
            (
                variant.name,
                [
                    *(_cell(row for row in of_one if row.region == region) for region in REGIONS),
                    f"{seconds(of_one):.2g}",
                ],
            )
            for variant, of_one in _by_variant(rows)
        ],
    )
    lines += ["", "Error against run time, fastest first: PSNR.", ""]
    lines += _table(
        "renderer",
        ["s a megapixel", *REGIONS],
        [
            (
                variant.name,
                [
                    f"{seconds(of_one):.2g}",
                    *(_psnr(row for row in of_one if row.region == region) for region in REGIONS),
                ],
            )
            for variant, of_one in sorted(_by_variant(rows), key=lambda pair: seconds(pair[1]))
            if variant.family
        ],
    )
    lines += [
        "",
        "By the largest radius in the picture, pixels: PSNR of the whole picture / beside depth edges.",
        "",
        *_by_radius(rows),
        "",
        "By scene: the same.",
        "",
        *_by_scene(rows),
        "",
    ]
    return lines


def _noise(source: str, rows: list[Score]) -> str:
    least = min(row.truth_psnr for row in rows)
    if math.isnan(least):
        return "Its own noise is not stated."
    if source == "rendered":
        return f"Noise leaves them {least:.1f} dB or more from what infinitely many rays would give."
    return f"A photograph from half of its lens points is {least:.1f} dB or more from the one used here."


def _by_radius(rows: list[Score]) -> list[str]:
    edges = np.percentile([row.radius for row in rows], [0, 100 / 3, 200 / 3, 100])
    # The last interval includes its upper end, so that it contains the largest radius.
    spans = [(low, high if high < edges[-1] else math.inf) for low, high in itertools.pairwise(edges) if low < high]
    spans = spans or [(edges[0], math.inf)]
    names = [f"{low:.1f} to {min(high, edges[-1]):.1f}" for low, high in spans]
    return _table(
        "renderer",
        names,
        [
            (variant.name, [_whole_and_edge(row for row in of_one if low <= row.radius < high) for low, high in spans])
            for variant, of_one in _by_variant(rows)
        ],
    )


def _by_scene(rows: list[Score]) -> list[str]:
    chosen = [(variant, of_one) for variant, of_one in _by_variant(rows) if variant.name in _BY_SCENE]
    return _table(
        "scene",
        [variant.name for variant, _ in chosen],
        [
            (name, [_whole_and_edge(row for row in of_one if row.name == name) for _, of_one in chosen])
            for name in dict.fromkeys(row.name for row in rows)
        ],
    )


def _by_variant(rows: list[Score]) -> list[tuple[Variant, list[Score]]]:
    found = [(variant, [row for row in rows if row.variant == variant.name]) for variant in VARIANTS]
    return [(variant, of_one) for variant, of_one in found if of_one]


def _photographs(rows: list[Score]) -> set[tuple[str, str, str, float, float]]:
    return {(row.source, row.name, row.view, row.aperture, row.focus) for row in rows}


def _table(first: str, columns: list[str], lines: list[tuple[str, list[str]]]) -> list[str]:
    return [
        f"| {first} | {' | '.join(columns)} |",
        "| --- |" + " --- |" * len(columns),
        *(f"| {name} | {' | '.join(cells)} |" for name, cells in lines),
    ]


def _cell(rows: Iterable[Score]) -> str:
    rows = list(rows)
    if not rows:
        return "–"
    if all(math.isinf(row.psnr) for row in rows):
        return "exact"
    ssim, flip = (float(np.mean([getattr(row, key) for row in rows])) for key in ("ssim", "flip"))
    return f"{mean_psnr(rows):.2f} / {ssim:.4f} / {flip:.4f}"


def _psnr(rows: Iterable[Score]) -> str:
    mean = mean_psnr(rows)
    return "–" if mean is None else f"{mean:.2f}"


def _whole_and_edge(rows: Iterable[Score]) -> str:
    rows = list(rows)
    return " / ".join(_psnr(row for row in rows if row.region == region) for region in ("all", "depth edge"))


def _load() -> str:
    """The cores, and whether the machine was busy: times on a busy machine can only be compared with each other."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    load = os.getloadavg()[2] if hasattr(os, "getloadavg") else 0.0
    busy = f", which others kept busy (load {load:.0f}): only their ratios count" if load > 2 * cores else ""
    return f", on {cores} cores{busy}"


def _command(settings: ValidateRenderer) -> str:
    words = ["dofbench", "validate-renderer", *(folder.name for folder in settings.truths)]
    return code(shlex.join(words + ([] if settings.planes else ["--no-planes"])))
