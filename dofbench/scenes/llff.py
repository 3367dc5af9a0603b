"""LLFF's layout (Mildenhall et al. 2019): poses_bounds.npy beside images, images_4, images_8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.readable import read_array
from dofbench.scenes.colmap import find_model, read_model
from dofbench.scenes.folders import choose_folder, image_files, match_files
from dofbench.scenes.poses import invert, llff_to_opencv, rigid
from dofbench.scenes.scene import Scene
from dofbench.scenes.undistort import Intrinsics
from dofbench.scenes.views import Frame, assemble, check_inside, held_out

_FILE = "poses_bounds.npy"


def fits(root: Path) -> bool:
    """Whether the folder has poses_bounds.npy."""
    return (root / _FILE).is_file()


def read(root: Path, *, width: int | None, images: str | None, hold: int | None) -> Scene:
    """Read the layout; see `load_scene`.

    Poses and focal length are poses_bounds.npy's, a pinhole with its principal point in the
    middle, as every LLFF loader has them (the distortion that COLMAP may have found for these
    photographs is left alone; read the folder as `layout="colmap"` to have it taken out). Row i
    belongs to the i-th image file in sorted order. Points come from the COLMAP model beside it.
    """
    folder = choose_folder(root, width=width, images=images, habit=(8, 4, 1))
    return held_out(read_folder(root, folder, width=width), hold)


def read_folder(root: Path, folder: Path, *, width: int | None) -> Scene:
    """The scene whose images are those of `folder`, without a split. Raises InputError."""
    file, files = root / _FILE, image_files(folder)
    frames = posed_frames(root, folder, files)
    model_folder = find_model(root)
    points = read_points(model_folder, folder, files) if model_folder else None
    scene = assemble(root, "llff", frames, points, width=width, subject=file)
    check_inside(scene, model_folder)
    return scene


def posed_frames(root: Path, folder: Path, files: Sequence[Path]) -> list[Frame]:
    """A frame an image: row i of poses_bounds.npy belongs to the i-th file. Raises InputError."""
    file = root / _FILE
    rows = _rows(file)
    if len(rows) != len(files):
        raise InputError(folder, f"{len(files)} images", f"the {len(rows)} that {file} has poses for")
    return [_frame(row, path, path.relative_to(folder).as_posix(), file) for row, path in zip(rows, files, strict=True)]


def _rows(file: Path) -> np.ndarray:
    rows = read_array(file, "an LLFF pose file, shape (N, 17)")
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        shape = f"shape {rows.shape}, {rows.dtype}"
        raise InputError(file, shape, "shape (N, 17) of floats: 3x5 pose, near, far")
    return rows.astype(np.float64)


def _frame(row: np.ndarray, path: Path, name: str, file: Path) -> Frame:
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    if not np.isfinite(matrix[:, 4]).all() or min(height, width, focal) <= 0:
        raise InputError(file, f"height {height}, width {width}, focal {focal} for {name}", "positive numbers")
    if height != int(height) or width != int(width):
        raise InputError(file, f"image size {width} x {height} for {name}", "whole pixels")
    pose = rigid(llff_to_opencv(matrix[:, :4]), file, name)
    lens = Intrinsics(int(width), int(height), float(focal), float(focal), width / 2, height / 2)
    return Frame(name, path, lens, invert(pose))


def read_points(model_folder: Path, folder: Path, files: Sequence[Path]) -> PointCloud | None:
    """The COLMAP model's points, with tracks over `files`, whose names may have been renumbered."""
    model = read_model(model_folder)
    points = model.points
    if points is None or points.views is None:
        return points
    place = {path: index for index, path in enumerate(files)}
    matched = match_files(folder, model.names, model_folder, by_order=True)
    rank = np.array([place[path] for path in matched], dtype=np.int64)
    return replace(points, views=tuple(np.sort(rank[track]) for track in points.views))
