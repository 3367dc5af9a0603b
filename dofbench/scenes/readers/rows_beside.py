"""Whether the rows of a poses_bounds.npy are the cameras of the COLMAP model beside it, image by image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.scenes.readers.colmap import Model
from dofbench.scenes.readers.folders import listed
from dofbench.scenes.readers.poses import invert, llff_to_opencv

# Rows and a model of the same cameras differ by rounding alone: of a rotation's entries, and of positions in shares of
# their spread.
_SAME = 1e-3
# Poses refined after structure from motion differ from its by less: degrees, and shares of the positions' spread.
_DEGREES, _OFFSET = 10.0, 0.2
# Fits of a similarity, each after the first to the better half of the cameras.
_FITS = 5
_CURE = "a row an image in the order of their names; --layout colmap reads the model by itself"


def check_order(rows: np.ndarray, model: Model, files: Sequence[int], names: Sequence[str], file: Path) -> str:
    """A note on images that stand elsewhere in the model than in their row; empty where none does.

    rows: of `file`, (N, 17), one for each of `names`. files: the row of each of the model's N images. Raises InputError
    where rows are those of other images of the model, or most have no counterpart up to a similarity.
    """
    ours = np.stack([llff_to_opencv(row[:15].reshape(3, 5)[:, :4]) for row in rows])
    theirs = np.empty_like(ours)
    for place, pose in zip(files, model.world_to_camera, strict=True):
        theirs[place] = invert(pose)[:3]
    spread = _spread(theirs[:, :, 3])
    if not np.isfinite(ours).all() or not spread > 0 or _same(ours, theirs, spread).all():
        return ""
    swapped = _others(ours, theirs, spread)
    if swapped:
        shown = ", ".join(f"{names[row]} has the row of {names[other]}" for row, other in swapped[:2])
        raise InputError(file, f"{len(swapped)} of {len(rows)} rows of other images ({shown})", _CURE)
    off = _off(ours, theirs)
    if 2 * off.sum() > len(rows):
        found = f"{off.sum()} of {len(rows)} cameras elsewhere than in {model.folder}, whatever frame it is in"
        raise InputError(file, found, _CURE)
    elsewhere = [names[row] for row in np.flatnonzero(off).tolist()]
    return f"{listed(elsewhere)} elsewhere in {file.name} than in the COLMAP model" if elsewhere else ""


def _same(ours: np.ndarray, theirs: np.ndarray, spread: float) -> np.ndarray:
    """(N,) whether cameras (N, 3, 4) are the same ones but for rounding."""
    turned = np.abs(ours[..., :3] - theirs[..., :3]).max(axis=(-2, -1))
    moved = np.linalg.norm(ours[..., 3] - theirs[..., 3], axis=-1)
    return np.asarray((turned < _SAME) & (moved <= _SAME * spread))


def _others(ours: np.ndarray, theirs: np.ndarray, spread: float) -> list[tuple[int, int]]:
    """Rows that are no camera of their own image and are one of another: (row, other)."""
    found = []
    for row in np.flatnonzero(~_same(ours, theirs, spread)):
        alike = np.flatnonzero(_same(ours[row], theirs, spread))
        found += [(int(row), int(alike[0]))] if len(alike) else []
    return found


def _off(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """(N,) whether cameras are turned or stand elsewhere under the similarity that fits the better half of them."""
    kept = np.ones(len(ours), dtype=bool)
    for _ in range(_FITS):
        left, _, right = np.linalg.svd(np.einsum("nij,nkj->ik", ours[kept, :, :3], theirs[kept, :, :3]))
        turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        turned = np.einsum("ij,njk,nlk->nil", turn, theirs[:, :, :3], ours[:, :, :3])
        degrees = np.degrees(np.arccos(np.clip(0.5 * (np.trace(turned, axis1=1, axis2=2) - 1), -1, 1)))
        here, there = ours[:, :, 3], theirs[:, :, 3] @ turn.T
        middle, other = here[kept].mean(axis=0), there[kept].mean(axis=0)
        scale = np.sum((here - middle)[kept] * (there - other)[kept]) / max(np.sum((there - other)[kept] ** 2), 1e-300)
        moved = np.linalg.norm(here - middle - scale * (there - other), axis=1) / max(_spread(here), 1e-300)
        cost = np.maximum(degrees / _DEGREES, moved / _OFFSET)
        kept = cost <= np.median(cost)
    return np.asarray(cost > 1)


def _spread(centres: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))
