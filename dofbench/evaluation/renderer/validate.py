"""The stages of validate-renderer: photographs, renderings, scores, and tables."""

from __future__ import annotations

import time
from itertools import chain
from pathlib import Path

import numpy as np
from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.files import write_text
from dofbench.core.images import write_png
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.renderer.detect import cases_in
from dofbench.evaluation.renderer.kept_scores import Store
from dofbench.evaluation.renderer.planes import plane_cases
from dofbench.evaluation.renderer.plot import plot_precision
from dofbench.evaluation.renderer.renderer_scores import Score, score
from dofbench.evaluation.renderer.renderer_tables import csv_text, markdown
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.evaluation.renderer.validation_options import ValidateRenderer
from dofbench.evaluation.renderer.variants import VARIANTS, Variant

PLANE_RADII = (4.0, 12.0)  # pixels per unit of disparity
PLANE_FOCUSES = (0.1, 0.5, 0.9)
_PICTURED = ("scatter", "layered, 16")
_GAIN = 5  # factor by which error pictures are brightened
_TABLES_EVERY = 10.0  # seconds between updates of the tables


def validate_renderer(settings: ValidateRenderer, console: Console | None = None) -> Path:
    """Score every renderer on every photograph; writes renderer.csv, renderer.md, plots and pictures to `out`.

    Every score is written as soon as it is computed, and the tables contain all scores so far, so the run may be
    interrupted at any time. Returns the folder. Raises InputError for a folder that holds no photographs with a known
    lens, and when there is nothing to do.
    """
    console = console or Console(stderr=True)
    cases = [
        *(plane_cases(PLANE_RADII, PLANE_FOCUSES) if settings.planes else ()),
        *chain.from_iterable(cases_in(folder) for folder in settings.truths),
    ]
    if not cases:
        raise InputError("validate-renderer --no-planes", "no folder", "something to compare with")
    store = Store(settings.out)
    cases = list({case.key: case for case in cases}.values())  # a folder may be named twice
    done = {case.key: store.read(case) for case in cases}
    try:
        _score_all(cases, done, store, settings, console)
    finally:
        rows = _rows(cases, done)
        if rows:
            _write(settings, cases, rows, [plot_precision(rows, settings.out)])
    console.print(f"{settings.out / 'renderer.md'}", highlight=False, markup=False)
    return settings.out


def _score_all(
    cases: list[Case],
    done: dict[str, dict[str, list[Score]]],
    store: Store,
    settings: ValidateRenderer,
    console: Console,
) -> None:
    open_cases = [case for case in cases if _missing(case, done[case.key]) or not _pictured(case, settings)]
    if len(open_cases) < len(cases):
        console.print(f"{len(cases) - len(open_cases)} of {len(cases)} photographs are scored already", highlight=False)
    begun = written = time.monotonic()
    ahead, behind = sum(case.megapixels for case in open_cases), 0.0
    for index, case in enumerate(open_cases):
        left = (time.monotonic() - begun) / behind * ahead if behind else None
        console.print(
            f"{index + 1} of {len(open_cases)}: {case.title}" + (f", {_clock(left)} left" if left else ""),
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
        truth = case.make()
        kept, renders = done[case.key], {}
        for variant in VARIANTS:
            if variant.can_render(case) and (variant.name not in kept or _wants(variant, settings)):
                kept[variant.name], renders[variant.name] = score(case, truth, variant)
                store.write(case, kept)
        if settings.pictures:
            write_png(_picture(case, settings), _strip(truth, renders))
        ahead, behind = ahead - case.megapixels, behind + case.megapixels
        if time.monotonic() - written > _TABLES_EVERY:
            _write(settings, cases, _rows(cases, done), [])
            written = time.monotonic()


def _missing(case: Case, kept: dict[str, list[Score]]) -> bool:
    return any(variant.name not in kept and variant.can_render(case) for variant in VARIANTS)


def _wants(variant: Variant, settings: ValidateRenderer) -> bool:
    return settings.pictures and variant.name in _PICTURED


def _picture(case: Case, settings: ValidateRenderer) -> Path:
    parts = [*filter(None, (case.source, case.name, case.view)), f"{case.aperture:.4g}", f"{case.focus:.4g}"]
    return settings.out / "pictures" / f"{file_name(*parts)}.png"


def _pictured(case: Case, settings: ValidateRenderer) -> bool:
    return not settings.pictures or _picture(case, settings).is_file()


def _rows(cases: list[Case], done: dict[str, dict[str, list[Score]]]) -> list[Score]:
    order = [variant.name for variant in VARIANTS]
    return [row for case in cases for name in order for row in done[case.key].get(name, [])]


def _write(settings: ValidateRenderer, cases: list[Case], rows: list[Score], plots: list[Path]) -> None:
    write_text(settings.out / "renderer.csv", csv_text(rows))
    write_text(settings.out / "renderer.md", markdown(rows, len(cases), settings, plots))


def _strip(truth: Truth, renders: dict[str, np.ndarray]) -> np.ndarray:
    """A picture strip: the photograph and the renderings; below, the sharp image and the error of each rendering."""
    images = [renders[name] for name in _PICTURED]
    errors = [np.clip(_GAIN * np.abs(image - truth.photograph), 0, 1) for image in images]
    sharp = np.clip(truth.sharp, 0, 1)
    return np.concatenate([np.concatenate([truth.photograph, *images], 1), np.concatenate([sharp, *errors], 1)], 0)


def _clock(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
