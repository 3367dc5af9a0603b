"""Triangulate points between photographs with known cameras."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.progress import Progress
from dofbench.scenes.readers.colmap import read_model
from dofbench.scenes.reconstruction.mapping import triangulate
from dofbench.scenes.reconstruction.matching import compare
from dofbench.scenes.reconstruction.photograph_list import LEAST, Photograph, Prepared, prepare
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.visibility import in_front

# COLMAP allows an error of 4 pixels, which suits photographs of this width; narrower ones are allowed less in
# proportion, but a pixel at least, since what is blurred isn't found more precisely than that.
_USUAL_WIDTH, _USUAL_ERROR, _LEAST_ERROR = 1600, 4.0, 1.0
_FEATURES = 8192


def program() -> str:
    """Name and version of the triangulating program."""
    from dofbench.scenes.colmap_binding import pycolmap

    return f"pycolmap {pycolmap.__version__}"


def triangulated_points(
    photographs: Sequence[Photograph], work: Path, seed: int, progress: Progress, *, narrow: bool = False
) -> PointCloud | None:
    """Triangulate features of these photographs, their cameras held fixed; None without any point.

    Tracks index into `photographs` and have at least two views. work: a folder for intermediate files, emptied first.
    narrow: as in `triangulate`. The same photographs and seed give the same bytes on one machine.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    if len(photographs) < LEAST:
        return None
    pycolmap.logging.minloglevel = 3  # as `reconstruct`: COLMAP's log would overwrite the progress display
    shutil.rmtree(work, ignore_errors=True)
    folder, database = work / "photographs", work / "database.db"
    folder.mkdir(parents=True)
    cameras = [photograph.camera for photograph in photographs if photograph.camera is not None]
    # At full size: nothing is shrunk that a method gets at this size.
    size = max(max(camera.width, camera.height) for camera in cameras)
    prepared = prepare(photographs, folder, size, lambda done: None)
    error = _error(prepared)
    settings = Reconstruct(work, work, camera_model="PINHOLE", features=_FEATURES, seed=seed)
    compare(database, folder, prepared, (), progress, settings, error=error)
    with progress.stage("points", 1) as advance:
        found = triangulate(database, folder, work, prepared, seed, lambda: None, error=error, narrow=narrow)
        advance(1)
    if not found.num_points3D():
        return None
    model = work / "model"
    model.mkdir()
    found.write_binary(model)
    points = read_model(model).points
    assert points is not None
    return _agreed(in_front(points, [photograph.camera for photograph in prepared if photograph.camera is not None]))


def _error(photographs: Sequence[Prepared]) -> float:
    """Pixels by which a photograph may miss a point."""
    widest = max(max(photograph.width, photograph.height) for photograph in photographs)
    return float(np.clip(_USUAL_ERROR * widest / _USUAL_WIDTH, _LEAST_ERROR, _USUAL_ERROR))


def _agreed(points: PointCloud) -> PointCloud | None:
    """The points seen in at least two views."""
    assert points.views is not None
    kept = np.array([len(track) > 1 for track in points.views])
    return points.kept(kept) if kept.any() else None
