"""The COLMAP model next to transforms.json or poses_bounds.npy: the same cameras? And its points in their frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.scenes.local_frame import AnotherFrame
from dofbench.scenes.readers.colmap import Model
from dofbench.scenes.readers.folders import listed
from dofbench.scenes.readers.name_match import ImageNames
from dofbench.scenes.readers.poses import invert, llff_to_opencv, rigid

# Poses refined after structure from motion differ from its by less, in the median and for each camera: degrees, and
# shares of the positions' spread. Points still fit them.
_DEGREES, _OFFSET = 5.0, 0.1
_EACH_DEGREES, _EACH_OFFSET = 10.0, 0.2
# Rows and a model of the same cameras differ by rounding alone: of a rotation's entries, and of positions in shares of
# their spread.
_SAME = 1e-3
# Fits of a similarity, each after the first to the better half of the cameras.
_FITS = 5
_CURE = "a row an image in the order of their names; --layout colmap reads the model by itself"


def points_beside(
    model: Model,
    content: Mapping[str, Any],
    scale: float,
    paths: Sequence[str],
    poses: Sequence[np.ndarray],
    file: Path,
) -> PointCloud | None:
    """The model's points by applied_transform and `scale`, with tracks over the frames; None without points.

    content: of transforms.json, `file`. paths, poses: of its frames, world-to-camera (4, 4), OpenCV axes. Raises
    InputError for a wrong transform, and AnotherFrame where cameras of one name differ between the two files by more
    than 5 degrees or a tenth of their spread, in the median. Points can fall inside such images all the same.
    """
    if model.points is None:
        return None
    turn = np.eye(4)
    if "applied_transform" in content:
        try:
            applied = np.array(content["applied_transform"], dtype=np.float64)
        except (TypeError, ValueError):
            applied = np.empty(0)
        turn = rigid(applied, file, "applied_transform")
    ranks = _ranks(model.names, paths)
    _check_cameras(model, turn, scale, ranks, poses)
    xyz = scale * (model.points.xyz @ turn[:3, :3].T + turn[:3, 3])
    tracks: tuple[np.ndarray, ...] | None = None
    if model.points.views is not None:
        tracks = tuple(np.sort(ranks[track][ranks[track] >= 0]) for track in model.points.views)
        tracks = tracks if any(len(track) for track in tracks) else None
    return replace(model.points, xyz=xyz, views=tracks)


def _check_cameras(
    model: Model, turn: np.ndarray, scale: float, ranks: np.ndarray, poses: Sequence[np.ndarray]
) -> None:
    known = np.flatnonzero(ranks >= 0)
    if not len(known):
        return
    theirs = np.stack([turn @ invert(model.world_to_camera[index]) for index in known])
    theirs[:, :3, 3] *= scale
    ours = np.stack([invert(poses[ranks[index]]) for index in known])
    cosine = 0.5 * (np.einsum("nij,nij->n", theirs[:, :3, :3], ours[:, :3, :3]) - 1)
    degrees = np.median(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    apart = np.median(np.linalg.norm(theirs[:, :3, 3] - ours[:, :3, 3], axis=1))
    spread = max(_spread(theirs[:, :3, 3]), _spread(ours[:, :3, 3]))
    if degrees > _DEGREES or apart > _OFFSET * spread > 0:
        by = f"{degrees:.0f} degrees and {apart:.2g} scene units (median; they are spread by {spread:.2g})"
        raise AnotherFrame(model.folder, f"cameras off by {by} from transforms.json's", "points and poses in one frame")


def _ranks(names: Sequence[str], paths: Sequence[str]) -> np.ndarray:
    """The frame of each of COLMAP's images, by its name; -1 where none has it, or several have."""
    frames = ImageNames([(path.partition("/")[2] or path, path) for path in paths], partial=True)
    ranks = np.full(len(names), -1, dtype=np.int64)
    for index, name in enumerate(names):
        images = frames.find(name).images
        if len(images) == 1:
            ranks[index] = images[0]
    shared = np.bincount(ranks[ranks >= 0], minlength=len(paths)) > 1
    ranks[(ranks >= 0) & shared[ranks]] = -1
    return ranks


def check_same_cameras(rows: np.ndarray, model: Model, file: Path) -> None:
    """Raise InputError unless row i of `file` is the model's i-th camera, as imgs2poses writes them."""
    theirs = np.stack([invert(pose)[:3] for pose in model.world_to_camera])
    ours = _cameras(rows)
    centres = theirs[:, :, 3]
    if not _same(ours, theirs, float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).mean())).all():
        found = f"{len(rows)} cameras that aren't those of {model.folder} in the order of their names"
        raise InputError(file, found, "the same poses in both; --layout colmap reads the model by itself")


def check_order(rows: np.ndarray, model: Model, files: Sequence[int], names: Sequence[str], file: Path) -> str:
    """A note on images whose row differs from their camera in the model; empty without any.

    rows: of `file`, (N, 17), one for each of `names`. files: the row of each of the model's N images. Raises InputError
    where rows are those of other images of the model, or most have no counterpart up to a similarity.
    """
    ours = _cameras(rows)
    theirs = np.empty_like(ours)
    for place, pose in zip(files, model.world_to_camera, strict=True):
        theirs[place] = invert(pose)[:3]
    spread = _spread(theirs[:, :, 3])
    if not np.isfinite(ours).all() or not spread > 0 or _same(ours, theirs, spread).all():
        return ""
    if swapped := _others(ours, theirs, spread):
        shown = ", ".join(f"{names[row]} has the row of {names[other]}" for row, other in swapped[:2])
        raise InputError(file, f"{len(swapped)} of {len(rows)} rows of other images ({shown})", _CURE)
    off = _off(ours, theirs)
    if 2 * off.sum() > len(rows):
        found = f"{off.sum()} of {len(rows)} cameras elsewhere than in {model.folder}, whatever frame it is in"
        raise InputError(file, found, _CURE)
    elsewhere = [names[row] for row in np.flatnonzero(off).tolist()]
    return f"{listed(elsewhere)} elsewhere in {file.name} than in the COLMAP model" if elsewhere else ""


def _cameras(rows: np.ndarray) -> np.ndarray:
    """(N, 3, 4) camera-to-world poses, OpenCV axes, of rows of poses_bounds.npy."""
    return np.stack([llff_to_opencv(row[:15].reshape(3, 5)[:, :4]) for row in rows])


def _same(ours: np.ndarray, theirs: np.ndarray, spread: float) -> np.ndarray:
    """(N,) whether cameras (N, 3, 4) are equal but for rounding."""
    turned = np.abs(ours[..., :3] - theirs[..., :3]).max(axis=(-2, -1))
    moved = np.linalg.norm(ours[..., 3] - theirs[..., 3], axis=-1)
    return np.asarray((turned < _SAME) & (moved <= _SAME * spread))


def _others(ours: np.ndarray, theirs: np.ndarray, spread: float) -> list[tuple[int, int]]:
    """(row, other) of rows that are not the camera of their own image but of another."""
    found = []
    for row in np.flatnonzero(~_same(ours, theirs, spread)):
        alike = np.flatnonzero(_same(ours[row], theirs, spread))
        found += [(int(row), int(alike[0]))] if len(alike) else []
    return found


def _off(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """(N,) whether cameras are turned or moved under the similarity that fits the better half of them."""
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
        cost = np.maximum(degrees / _EACH_DEGREES, moved / _EACH_OFFSET)
        kept = cost <= np.median(cost)
    return np.asarray(cost > 1)


def _spread(centres: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))
