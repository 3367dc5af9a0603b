"""The stages of validate-renderer: images with optical blur, renderings, scores, tables."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import numpy as np
from rich.console import Console

from dofbench.core.errors import InputError
from dofbench.core.files import write_text
from dofbench.core.images import write_png
from dofbench.evaluation.figures import file_name
from dofbench.evaluation.renderer.blb import INFO, blb_cases, is_blb
from dofbench.evaluation.renderer.lightfield import lightfield_cases
from dofbench.evaluation.renderer.planes import plane_cases
from dofbench.evaluation.renderer.rendered import SCENE, is_rendered, rendered_cases
from dofbench.evaluation.renderer.renderer_scores import Score, Store, score
from dofbench.evaluation.renderer.renderer_tables import csv_text, markdown, plot_precision
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.evaluation.renderer.validation_options import ValidateRenderer
from dofbench.evaluation.renderer.variants import VARIANTS, Variant
from dofbench.scenes.light_field.grid import GRID

PLANE_RADII = (4.0, 12.0)  # pixels per unit of disparity
PLANE_FOCUSES = (0.1, 0.5, 0.9)
_PICTURED = ("scatter", "layered, 16")
_GAIN = 5  # brightens error pictures
_TABLES_EVERY = 10.0  # seconds between updates of the tables
_LAYOUTS: tuple[tuple[Callable[[Path], bool], Callable[[Path], list[Case]]], ...] = (
    (lambda folder: (folder / GRID).is_file(), lightfield_cases),
    (is_rendered, rendered_cases),
    (is_blb, blb_cases),
)

Scores = dict[str, list[Score]]  # by variant


def validate_renderer(settings: ValidateRenderer, console: Console | None = None) -> Path:
    """Score every renderer on every image; writes renderer.csv, renderer.md, plots and pictures to `out`.

    Scores are written as soon as they are computed; rerun to resume. Returns the folder. Raises InputError for a folder
    without images of known lens, and without anything to do.
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


def cases_in(folder: Path) -> list[Case]:
    """The images of a light field, a rendered scene, a BLB scene, or of a folder of such folders.

    Raises InputError for any other folder, and for an incomplete one.
    """
    if not folder.is_dir():
        raise InputError(folder, "no folder" if not folder.exists() else "a file", "a folder")
    found = _cases(folder)
    if found is None:
        inside = [_cases(entry) for entry in sorted(folder.iterdir()) if entry.is_dir()]
        found = [case for cases in inside if cases is not None for case in cases]
    if not found:
        layouts = f"a light field ({GRID}), a rendered scene ({SCENE}), a scene of BLB ({INFO}), or a folder of these"
        raise InputError(folder, "no photographs with a known lens", layouts)
    return found


def _cases(folder: Path) -> list[Case] | None:
    """None for a folder of another layout."""
    return next((cases(folder) for is_one, cases in _LAYOUTS if is_one(folder)), None)


def _score_all(
    cases: list[Case], done: dict[str, Scores], store: Store, settings: ValidateRenderer, console: Console
) -> None:
    todo = [case for case in cases if _missing(case, done[case.key]) or not _pictured(case, settings)]
    if len(todo) < len(cases):
        console.print(f"{len(cases) - len(todo)} of {len(cases)} photographs are scored already", highlight=False)
    begun = written = time.monotonic()
    ahead, behind = sum(case.megapixels for case in todo), 0.0
    for index, case in enumerate(todo):
        left = (time.monotonic() - begun) / behind * ahead if behind else None
        line = f"{index + 1} of {len(todo)}: {case.title}" + (f", {_clock(left)} left" if left else "")
        console.print(line, highlight=False, markup=False, soft_wrap=True)
        truth, kept, renders = case.make(), done[case.key], {}
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


def _missing(case: Case, kept: Scores) -> bool:
    return any(variant.name not in kept and variant.can_render(case) for variant in VARIANTS)


def _wants(variant: Variant, settings: ValidateRenderer) -> bool:
    return settings.pictures and variant.name in _PICTURED


def _picture(case: Case, settings: ValidateRenderer) -> Path:
    parts = [*filter(None, (case.source, case.name, case.view)), f"{case.aperture:.4g}", f"{case.focus:.4g}"]
    return settings.out / "pictures" / f"{file_name(*parts)}.png"


def _pictured(case: Case, settings: ValidateRenderer) -> bool:
    return not settings.pictures or _picture(case, settings).is_file()


def _rows(cases: list[Case], done: dict[str, Scores]) -> list[Score]:
    return [row for case in cases for variant in VARIANTS for row in done[case.key].get(variant.name, [])]


def _write(settings: ValidateRenderer, cases: list[Case], rows: list[Score], plots: list[Path]) -> None:
    write_text(settings.out / "renderer.csv", csv_text(rows))
    write_text(settings.out / "renderer.md", markdown(rows, len(cases), settings, plots))


def _strip(truth: Truth, renders: dict[str, np.ndarray]) -> np.ndarray:
    """A picture strip: the photograph and the renderings; below, the all-in-focus image and the renderings' errors."""
    images = [renders[name] for name in _PICTURED]
    errors = [np.clip(_GAIN * np.abs(image - truth.photograph), 0, 1) for image in images]
    sharp = np.clip(truth.sharp, 0, 1)
    return np.concatenate([np.concatenate([truth.photograph, *images], 1), np.concatenate([sharp, *errors], 1)], 0)


def _clock(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
