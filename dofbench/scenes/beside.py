"""The COLMAP model beside a transforms.json: its points in the file's frame, if that is one frame with the model's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.scenes.local_frame import AnotherFrame
from dofbench.scenes.readers.colmap import Model
from dofbench.scenes.readers.name_match import ImageNames
from dofbench.scenes.readers.poses import invert, rigid

# Poses that were refined after structure from motion differ from its by less, and points still fit them.
_DEGREES, _OFFSET = 5.0, 0.1


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
    InputError for a transform that is none, and AnotherFrame where the cameras of one name stand elsewhere in the two
    files: turned by more than 5 degrees or moved by more than a tenth of their spread, in the median. Points can fall
    inside such images all the same.
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
    return replace(model.points, xyz=xyz, views=_tracks(model.points, ranks))


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


def _spread(centres: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))


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


def _tracks(points: PointCloud, ranks: np.ndarray) -> tuple[np.ndarray, ...] | None:
    """Tracks over COLMAP's images turned to tracks over the frames; None where the names don't belong together."""
    if points.views is None:
        return None
    tracks = tuple(np.sort(ranks[track][ranks[track] >= 0]) for track in points.views)
    return tracks if any(len(track) for track in tracks) else None
