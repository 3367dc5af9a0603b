"""LLFF's layout (Mildenhall et al. 2019): poses_bounds.npy next to images, images_4, images_8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.readable import read_array
from dofbench.scenes.readers.colmap import Model, read_found
from dofbench.scenes.readers.colmap_places import choose_model
from dofbench.scenes.readers.folders import (
    choose_folder,
    fewer_points,
    find_matches,
    image_files,
    match_files,
    refuse_missing,
    skipped,
    without_pose,
)
from dofbench.scenes.readers.model_beside import check_order, check_same_cameras
from dofbench.scenes.readers.poses import Mended, invert, llff_to_opencv, rigid
from dofbench.scenes.scene import Scene
from dofbench.scenes.undistort import Intrinsics
from dofbench.scenes.views import Frame, among_all, assemble, check_inside, held_out

FILE = "poses_bounds.npy"


def fits(root: Path) -> bool:
    """Whether the folder has poses_bounds.npy."""
    return (root / FILE).is_file()


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`.

    Poses and focal length come from poses_bounds.npy, for a pinhole with a centred principal point, as in every LLFF
    loader (`layout="colmap"` removes distortion that COLMAP found). Row i belongs to the i-th image file in sorted
    order; where their numbers differ, to the i-th name of the COLMAP model next to it, if its cameras are the rows'.
    Points come from the model.
    """
    folder = choose_folder(root, width=width, images=images, habit=(8, 4, 1))
    return held_out(read_folder(root, folder, width=width, skip_missing=skip_missing), hold)


def read_folder(root: Path, folder: Path, *, width: int | None, skip_missing: bool = False) -> Scene:
    """The scene with the images of `folder`, without a split. Raises InputError."""
    file, files = root / FILE, image_files(folder)
    found = choose_model(root)
    model = read_found(found) if found else None
    rows, notes = rows_of(file), list(model.notes if model else ())
    kept, called, absent = list(range(len(rows))), dict[Path, str](), list[str]()
    matched = None if model is None else find_matches(folder, model.names, model.folder)
    # As many files as rows, some of them of other images: some were deleted, others never had a pose.
    others = model is not None and matched is not None and 0 < len(matched.present()) < len(model.names) == len(rows)
    if len(rows) != len(files) or others:
        if model is None or matched is None or len(model.names) != len(rows) or not matched.present():
            cure = "; --layout colmap reads the COLMAP model by itself" if matched and matched.present() else ""
            raise _other_number(rows, folder, files, file, cure)
        check_same_cameras(rows, model, file)
        if not skip_missing:
            refuse_missing(folder, model.names, matched, model.folder)
        names, points, kept, model = model.names, model.points, matched.present(), model.only(matched.present())
        notes += [
            f"{len(rows)} poses for {len(files)} images: row i of {FILE} belongs to the i-th name in the COLMAP model",
            skipped(names, matched, FILE),
            fewer_points(points, model.points),
            without_pose(folder, matched.found(), FILE),
        ]
        absent, files = matched.missing(names), matched.found()
        called = dict(zip(files, model.names, strict=True))
    elif model is not None and len(model.names) == len(rows):
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


def _other_number(rows: np.ndarray, folder: Path, files: Sequence[Path], file: Path, cure: str = "") -> InputError:
    return InputError(folder, f"{len(files)} images", f"the {len(rows)} that {file} has poses for{cure}")


def posed_frames(root: Path, folder: Path, files: Sequence[Path]) -> list[Frame]:
    """A frame an image: row i of poses_bounds.npy belongs to the i-th file. Raises InputError."""
    file = root / FILE
    rows = rows_of(file)
    if len(rows) != len(files):
        raise _other_number(rows, folder, files, file)
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


def tracked_points(model: Model, folder: Path, files: Sequence[Path]) -> PointCloud | None:
    """The COLMAP model's points, with tracks over `files`, whose names may have been renumbered."""
    points = model.points
    if points is None or points.views is None:
        return points
    place = {path: index for index, path in enumerate(files)}
    matched = match_files(folder, model.names, model.folder, by_order=True)
    rank = np.array([place[path] for path in matched], dtype=np.int64)
    return replace(points, views=tuple(np.sort(rank[track]) for track in points.views))
