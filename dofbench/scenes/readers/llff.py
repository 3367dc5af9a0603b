"""LLFF's layout (Mildenhall et al. 2019): poses_bounds.npy beside images, images_4, images_8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.readable import read_array
from dofbench.scenes.readers.colmap import Model, read_found, read_model
from dofbench.scenes.readers.colmap_places import choose_model
from dofbench.scenes.readers.folders import choose_folder, find_matches, image_files, match_files, refuse_missing
from dofbench.scenes.readers.poses import Mended, invert, llff_to_opencv, rigid
from dofbench.scenes.readers.rows_beside import check_order
from dofbench.scenes.scene import Scene
from dofbench.scenes.undistort import Intrinsics
from dofbench.scenes.unused import fewer_points, skipped, without_pose
from dofbench.scenes.views import Frame, among_all, assemble, check_inside, held_out

_FILE = "poses_bounds.npy"
# Rows and a model of the same cameras differ by rounding alone: of a rotation's entries, and of positions in shares of
# their spread.
_SAME = 1e-3


def fits(root: Path) -> bool:
    """Whether the folder has poses_bounds.npy."""
    return (root / _FILE).is_file()


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`.

    Poses and focal length are poses_bounds.npy's, a pinhole with its principal point in the
    middle, as every LLFF loader has them (the distortion that COLMAP may have found for these
    photographs is left alone; read the folder as `layout="colmap"` to have it taken out). Row i
    belongs to the i-th image file in sorted order; where there are more or fewer files than rows, to the i-th name of
    the COLMAP model beside it, if that has as many and its cameras are turned as the rows'. Points come from the model.
    """
    folder = choose_folder(root, width=width, images=images, habit=(8, 4, 1))
    return held_out(read_folder(root, folder, width=width, skip_missing=skip_missing), hold)


def read_folder(root: Path, folder: Path, *, width: int | None, skip_missing: bool = False) -> Scene:
    """The scene whose images are those of `folder`, without a split. Raises InputError."""
    file, files = root / _FILE, image_files(folder)
    found = choose_model(root)
    model = read_found(found) if found else None
    rows, notes = rows_of(file), list(model.notes if model else ())
    kept = list(range(len(rows)))
    matched = None if model is None else find_matches(folder, model.names, model.folder)
    # As many files as rows, some of them of other images: some were deleted, others never had a pose.
    others = model is not None and matched is not None and 0 < len(matched.present()) < len(model.names) == len(rows)
    if len(rows) != len(files) or others:
        if model is None or matched is None or len(model.names) != len(rows) or not matched.present():
            cure = "; --layout colmap reads the COLMAP model by itself" if matched and matched.present() else ""
            raise InputError(folder, f"{len(files)} images", f"the {len(rows)} that {file} has poses for{cure}")
        _check_same_cameras(rows, model, file)
        if not skip_missing:
            refuse_missing(folder, model.names, matched, model.folder)
        names, points, kept, model = model.names, model.points, matched.present(), model.only(matched.present())
        notes += [
            f"{len(rows)} poses for {len(files)} images: row i of {_FILE} belongs to the i-th name in the COLMAP model",
            skipped(names, matched, _FILE),
            fewer_points(points, model.points),
            without_pose(folder, [path for path in matched.files if path], _FILE),
        ]
        absent = [name for name, path in zip(names, matched.files, strict=True) if path is None]
        files = [path for path in matched.files if path is not None]
        called = dict(zip(files, model.names, strict=True))
    else:
        called, absent = {}, []
        if model is not None and len(model.names) == len(rows):
            order = find_matches(folder, model.names, model.folder, by_order=True).files
            if None not in order:
                of_rows = [path.relative_to(folder).as_posix() for path in files]
                place = {path: index for index, path in enumerate(files)}
                notes.append(check_order(rows, model, [place[path] for path in order if path], of_rows, file))
    mended = Mended()
    frames = _frames(rows[kept], folder, files, file, mended)
    points = None if model is None else tracked_points(model, folder, files)
    scene = assemble(root, "llff", frames, points, width=width, subject=file).noted(*notes, *mended.notes(file))
    check_inside(scene, found.folder if found else None)
    return among_all(scene, called, absent)


def _check_same_cameras(rows: np.ndarray, model: Model, file: Path) -> None:
    """Raise InputError unless row i is the model's i-th camera, as imgs2poses writes them."""
    theirs = np.stack([invert(pose) for pose in model.world_to_camera])
    ours = np.stack([llff_to_opencv(row[:15].reshape(3, 5)[:, :4]) for row in rows])
    turned = np.abs(theirs[:, :3, :3] - ours[:, :, :3]).max()
    moved = np.linalg.norm(theirs[:, :3, 3] - ours[:, :, 3], axis=1).max()
    spread = np.linalg.norm(theirs[:, :3, 3] - theirs[:, :3, 3].mean(axis=0), axis=1).mean()
    if not (turned < _SAME and moved <= _SAME * spread):
        found = f"{len(rows)} cameras that aren't those of {model.folder} in the order of their names"
        raise InputError(file, found, "the same poses in both; --layout colmap reads the model by itself")


def posed_frames(root: Path, folder: Path, files: Sequence[Path]) -> list[Frame]:
    """A frame an image: row i of poses_bounds.npy belongs to the i-th file. Raises InputError."""
    file = root / _FILE
    rows = rows_of(file)
    if len(rows) != len(files):
        raise InputError(folder, f"{len(files)} images", f"the {len(rows)} that {file} has poses for")
    return _frames(rows, folder, files, file, Mended())


def _frames(rows: np.ndarray, folder: Path, files: Sequence[Path], file: Path, mended: Mended) -> list[Frame]:
    names = [path.relative_to(folder).as_posix() for path in files]
    return [_frame(row, path, name, file, mended) for row, path, name in zip(rows, files, names, strict=True)]


def rows_of(file: Path) -> np.ndarray:
    """The rows of a poses_bounds.npy, (N, 17) float64. Raises InputError."""
    rows = read_array(file, "an LLFF pose file, shape (N, 17)")
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        shape = f"shape {rows.shape}, {rows.dtype}"
        raise InputError(file, shape, "shape (N, 17) of floats: 3x5 pose, near, far")
    return rows.astype(np.float64)


def _frame(row: np.ndarray, path: Path, name: str, file: Path, mended: Mended) -> Frame:
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    if not np.isfinite(matrix[:, 4]).all() or min(height, width, focal) <= 0:
        raise InputError(file, f"height {height}, width {width}, focal {focal} for {name}", "positive numbers")
    if height != int(height) or width != int(width):
        raise InputError(file, f"image size {width} x {height} for {name}", "whole pixels")
    pose = rigid(llff_to_opencv(matrix[:, :4]), file, name, mended)
    lens = Intrinsics(int(width), int(height), float(focal), float(focal), width / 2, height / 2)
    return Frame(name, path, lens, invert(pose))


def read_points(model_folder: Path, folder: Path, files: Sequence[Path]) -> PointCloud | None:
    """The COLMAP model's points, with tracks over `files`, whose names may have been renumbered."""
    return tracked_points(read_model(model_folder), folder, files)


def tracked_points(model: Model, folder: Path, files: Sequence[Path]) -> PointCloud | None:
    """As `read_points`, of a model that has been read."""
    points = model.points
    if points is None or points.views is None:
        return points
    place = {path: index for index, path in enumerate(files)}
    matched = match_files(folder, model.names, model.folder, by_order=True)
    rank = np.array([place[path] for path in matched], dtype=np.int64)
    return replace(points, views=tuple(np.sort(rank[track]) for track in points.views))
