"""The run of validate-renderer: photographs, renders, scores, and the tables made of them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, fields
from itertools import chain
from pathlib import Path

import numpy as np
from rich.console import Console

from dofbench.files import write_text
from dofbench.images import write_png
from dofbench.validation.lightfield import photographs, read_lightfield
from dofbench.validation.planes import planes
from dofbench.validation.regions import REGIONS
from dofbench.validation.score import Score, score
from dofbench.validation.settings import ValidateRenderer
from dofbench.validation.truth import Truth
from dofbench.validation.variants import VARIANTS

PLANE_RADII = (4.0, 12.0)        # pixels per unit of disparity
PLANE_FOCUSES = (0.1, 0.5, 0.9)
_PICTURED = ("scatter", "layered, 16")
_GAIN = 5  # of the error pictures


def validate_renderer(settings: ValidateRenderer, console: Console | None = None) -> Path:
    """Score every renderer on every photograph; writes renderer.csv, renderer.md and pictures, returns the folder.

    Raises InputError for a folder that is no light field.
    """
    console = console or Console(stderr=True)
    fields_read = [read_lightfield(folder) for folder in settings.lightfields]
    truths: Iterator[Truth] = chain(
        chain.from_iterable(planes(radius, PLANE_FOCUSES) for radius in PLANE_RADII),
        chain.from_iterable(photographs(field) for field in fields_read),
    )
    scores: list[Score] = []
    for truth in truths:
        title = f"{truth.name}, radius {truth.aperture:.1f}, focus {truth.focus:.2f}"
        console.print(title, highlight=False, markup=False)
        renders = {}
        for row, image in score(truth):
            scores.append(row)
            renders[row.variant] = image
        if settings.pictures:
            name = f"{truth.source}-{truth.name}-{truth.aperture:.1f}-{truth.focus:.2f}.png".replace(" ", "-")
            write_png(settings.out / "pictures" / name, _strip(truth, renders))
    write_text(settings.out / "renderer.csv", _csv(scores))
    write_text(settings.out / "renderer.md", _markdown(scores, settings))
    console.print(f"{settings.out / 'renderer.md'}", highlight=False, markup=False)
    return settings.out


def _strip(truth: Truth, renders: dict[str, np.ndarray]) -> np.ndarray:
    """Photograph and renders, and below each render its error."""
    images = [renders[name] for name in _PICTURED]
    errors = [np.clip(_GAIN * np.abs(image - truth.photograph), 0, 1) for image in images]
    sharp = np.clip(truth.sharp, 0, 1)
    return np.concatenate([np.concatenate([truth.photograph, *images], 1), np.concatenate([sharp, *errors], 1)], 0)


def _csv(scores: Iterable[Score]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([field.name for field in fields(Score)])
    for row in scores:
        writer.writerow([f"{value:.8g}" if isinstance(value, float) else value for value in asdict(row).values()])
    return text.getvalue()


def _markdown(scores: list[Score], settings: ValidateRenderer) -> str:
    lines = ["# How close the renderers come to optical blur", "", _command(settings), ""]
    for source in dict.fromkeys(row.source for row in scores):
        of_source = [row for row in scores if row.source == source]
        photographs_scored = len({(row.name, row.aperture, row.focus) for row in of_source})
        least = min(row.truth_psnr for row in of_source)
        lines += [f"## {source}", "",
                  f"{photographs_scored} photographs: {_WHAT[source]} Mean PSNR in dB / SSIM / FLIP. A photograph "
                  f"from half of its lens points is {least:.1f} dB or more from the one used here.", "",
                  "| renderer | " + " | ".join(REGIONS) + " | s a megapixel |",
                  "| --- |" + " --- |" * (len(REGIONS) + 1)]
        for variant in VARIANTS:
            rows = [row for row in of_source if row.variant == variant]
            cells = [_cell([row for row in rows if row.region == region]) for region in REGIONS]
            seconds = float(np.median([row.seconds_per_megapixel for row in rows]))
            lines.append(f"| {variant} | {' | '.join(cells)} | {seconds:.2g} |")
        lines += ["",
                  "By the largest radius in the picture, pixels: PSNR of the whole picture / beside depth edges.", "",
                  *_by_aperture(of_source), ""]
    return "\n".join(lines)


_WHAT = {
    "planes": "textured planes before an exact thin lens, depth known exactly.",
    "light field": "views of a real light field, added over a round aperture; disparity by a plane sweep over all "
                   "views, so its errors are part of every renderer's.",
}


def _command(settings: ValidateRenderer) -> str:
    folders = " ".join(folder.name for folder in settings.lightfields)
    return f"`dofbench validate-renderer {folders}`".replace(" `", "`")


def _cell(rows: list[Score]) -> str:
    if not rows:
        return "–"
    psnr, ssim, flip = (float(np.mean([getattr(row, key) for row in rows])) for key in ("psnr", "ssim", "flip"))
    return f"{psnr:.2f} / {ssim:.4f} / {flip:.4f}" if math.isfinite(psnr) else "exact"


def _by_aperture(rows: list[Score]) -> list[str]:
    edges = np.percentile([row.aperture for row in rows], [0, 100 / 3, 200 / 3, 100])
    names = [f"{low:.1f} to {high:.1f}" for low, high in zip(edges, edges[1:], strict=False)]
    lines = ["| renderer | " + " | ".join(names) + " |", "| --- |" + " --- |" * len(names)]
    for variant in VARIANTS:
        cells = []
        for index, (low, high) in enumerate(zip(edges, edges[1:], strict=False)):
            last = index == len(edges) - 2
            chosen = [row for row in rows if row.variant == variant and low <= row.aperture
                      and (row.aperture < high or (last and row.aperture <= high))]
            values = [[row.psnr for row in chosen if row.region == region] for region in ("all", "depth edge")]
            cells.append(" / ".join(f"{np.mean(v):.2f}" if v else "–" for v in values))
        lines.append(f"| {variant} | {' | '.join(cells)} |")
    return lines
