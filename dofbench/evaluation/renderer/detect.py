"""Finds the photographs with known lens in a folder, whose layout is detected by its content."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.evaluation.renderer.blb import INFO, blb_cases, is_blb
from dofbench.evaluation.renderer.lightfield import GRID, lightfield_cases
from dofbench.evaluation.renderer.rendered import SCENE, is_rendered, rendered_cases
from dofbench.evaluation.renderer.renderer_truth import Case

_LAYOUTS: tuple[tuple[Callable[[Path], bool], Callable[[Path], list[Case]]], ...] = (
    (lambda folder: (folder / GRID).is_file(), lightfield_cases),
    (is_rendered, rendered_cases),
    (is_blb, blb_cases),
)


def cases_in(folder: Path) -> list[Case]:
    """The photographs of a light field, a rendered scene, a BLB scene, or of a folder that contains such folders.

    Raises InputError, one line, for any other folder, and for an incomplete one.
    """
    if not folder.is_dir():
        raise InputError(folder, "no folder" if not folder.exists() else "a file", "a folder")
    found = _cases(folder)
    if found is None:
        inside = [_cases(entry) for entry in sorted(folder.iterdir()) if entry.is_dir()]
        found = [case for cases in inside if cases is not None for case in cases]
    if not found:
        raise InputError(
            folder,
            "no photographs with a known lens",
            f"a light field ({GRID}), a rendered scene ({SCENE}), a scene of BLB ({INFO}), or a folder of these",
        )
    return found


def _cases(folder: Path) -> list[Case] | None:
    """None for a folder of another layout."""
    for is_one, cases in _LAYOUTS:
        if is_one(folder):
            return cases(folder)
    return None
