"""nerfstudio's transforms.json (and instant-ngp's, which it grew from)."""

from __future__ import annotations

import math
import posixpath
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from dofbench.core.cameras import Offset
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.files import read_json
from dofbench.core.images import image_size
from dofbench.scenes.ply import read_ply
from dofbench.scenes.readers.colmap import read_found
from dofbench.scenes.readers.colmap_places import choose_model
from dofbench.scenes.readers.folders import (
    MatchedFiles,
    choose_folder,
    find_files,
    find_matches,
    image_folders,
    listed,
    other_format,
    refuse_missing,
    skipped,
    without_pose,
)
from dofbench.scenes.readers.model_beside import points_beside
from dofbench.scenes.readers.name_match import plain, plain_inside
from dofbench.scenes.readers.poses import Mended, invert, opengl_to_opencv, rigid
from dofbench.scenes.readers.split_files import FileSplit, agreed, split_sources
from dofbench.scenes.scene import Scene, Split
from dofbench.scenes.undistort import Intrinsics
from dofbench.scenes.views import Frame, among_all, assemble, check_inside, held_as_asked, held_out

_FILE = "transforms.json"
LISTS = f"the lists of {_FILE}"
_PARTS = ("train", "test", "val")
_FISHEYE = ("OPENCV_FISHEYE",)
_PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
# nerfstudio reads 16-bit depth as millimetres unless told otherwise; a float map is in scene units.
# No pixel, angle, coefficient or factor is so large; its products stay finite.
_LARGEST = 1e30
_PNG_UNIT = 1e-3


def fits(root: Path) -> bool:
    """Whether the folder has transforms.json."""
    return (root / _FILE).is_file()


def read(
    root: Path,
    *,
    width: int | None,
    images: str | None,
    hold: int | None,
    skip_missing: bool = False,
    offset: Offset | None = None,
) -> Scene:
    """Read the layout; see `load_scene`. offset: the scene's, where known.

    transform_matrix is camera-to-world with OpenGL axes. Intrinsics stand in a frame or for all frames; camera_angle_x,
    camera_angle_y replace a missing focal length. depth_file_path: z-depth, times `depth_unit_scale_factor` (default
    0.001 for PNG, 1 for EXR). Points: ply_file_path, else the COLMAP model next to the file, by applied_transform and
    applied_scale. Views in val_filenames alone are excluded.
    """
    file = root / _FILE
    content = _parse(file)
    aside = _set_aside(content, file)
    entries = [entry for entry in content["frames"] if _path(entry, file) not in aside]
    every_path = [_path(entry, file) for entry in entries]
    folder, matched = _images(root, every_path, width, images, file)
    if not skip_missing or not matched.present():
        refuse_missing(folder, every_path, matched, file)
    entries, paths = ([rows[index] for index in matched.present()] for rows in (entries, every_path))
    files = matched.found()
    splits = _splits(content, every_path, file)
    mended = Mended()
    frames = [
        _frame(root, content, entry, path, image, file, mended)
        for entry, path, image in zip(entries, paths, files, strict=True)
    ]
    if splits is not None:
        frames = [replace(frame, split=splits[path]) for frame, path in zip(frames, paths, strict=True)]
    points, origin, notes = _points(root, content, paths, frames, file)
    scene = assemble(root, "nerfstudio", frames, points, width=width, subject=file, offset=offset).noted(
        f"{listed(sorted(aside))} skipped, in val_filenames alone" if aside else "",
        *notes,
        *mended.notes(file),
        skipped(every_path, matched, _FILE),
        without_pose(folder, files, _FILE) if folder != root and not aside else "",
        other_format(matched, folder, _FILE),
    )
    check_inside(scene, origin)
    absent, called = matched.missing(every_path), dict(zip(files, paths, strict=True))
    scene = among_all(scene, called, absent)
    if splits is None:
        return held_out(scene, hold, called, absent)
    if hold is not None:
        return held_as_asked(scene, hold, [LISTS, *split_sources(root)])
    return agreed(replace(scene, split_by=LISTS), called, absent)


def _parse(file: Path) -> dict[str, Any]:
    content = read_json(file)
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise InputError(file, "no list of frames", 'a JSON object with "frames", one object a view')
    content = with_test_frames(content, file)
    paths = [_path(frame, file) for frame in frames]
    if len(set(paths)) < len(paths):
        twice = sorted({path for path in paths if paths.count(path) > 1})
        raise InputError(file, f"several frames for {listed(twice)}", "one frame an image")
    return content


def with_test_frames(content: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Merge ScanNet++'s `test_frames` into frames and test_filenames, the others into train_filenames.

    Raises InputError for a wrong list, and for one together with lists of names.
    """
    tests, frames = content.get("test_frames"), content.get("frames")
    if not tests or not isinstance(frames, list):
        return dict(content)
    if not isinstance(tests, list) or not all(isinstance(frame, dict) for frame in tests):
        raise InputError(file, "test_frames that is no list of frames", "one object a test view, as in frames")
    named = [name for part in _PARTS if content.get(name := f"{part}_filenames") is not None]
    if named:
        raise InputError(file, f"test_frames and {' and '.join(named)}", "one of them: they say the split")
    train, test = [_path(frame, file) for frame in frames], [_path(frame, file) for frame in tests]
    both = sorted(set(train) & set(test))
    if both:
        raise InputError(file, f"{listed(both)} in frames and in test_frames", "a view in one of them")
    return {**content, "frames": [*frames, *tests], "train_filenames": train, "test_filenames": test}


def _path(entry: Mapping[str, Any], file: Path) -> str:
    path = entry.get("file_path")
    if not isinstance(path, str) or not path:
        raise InputError(file, f"file_path {path!r}", "the path of an image")
    return _inside(path, file)


def _inside(path: str, file: Path) -> str:
    """A path relative to the scene folder, in which it has to stay, however it is spelled."""
    spelled = posixpath.normpath(plain(path))
    for folder in (file.parent.absolute(), file.parent.resolve()):
        # As some programs write them, on the machine where the scene still is.
        spelled = spelled.removeprefix(f"{folder.as_posix()}/")
    if spelled.startswith("../"):
        found = f"{path}, which leads out of its folder"
        raise InputError(file, found, "paths inside it: move the file to the folder that has both, or link the images")
    return plain_inside(spelled, file)


def _number(value: Any, name: str, file: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise InputError(file, f"{name} {value!r}", f"a number, below {_LARGEST:g}")
    return float(value)


def _images(
    root: Path, paths: Sequence[str], width: int | None, images: str | None, file: Path
) -> tuple[Path, MatchedFiles]:
    """The image file of every frame, as written or in the folder asked for or wide enough, and their common folder."""
    first = {PurePosixPath(path).parts[0] for path in paths}
    inside = all(len(PurePosixPath(path).parts) > 1 for path in paths)
    base = first.pop() if len(first) == 1 and inside else ""
    if not base and images is not None:
        raise InputError(file, f"images in {listed(sorted(first | {base}))}", f"one folder, to read {images} instead")
    if images is None and (width is None or not base or len(image_folders(root, base)) < 2):
        return root / base, find_files(root, paths, file)
    names = [PurePosixPath(path).relative_to(base).as_posix() for path in paths]
    folder = choose_folder(root, width=width, images=images, habit=(1,), base=base)
    return folder, find_matches(folder, names, file)


def _frame(
    root: Path, content: Mapping[str, Any], entry: Mapping[str, Any], name: str, image: Path, file: Path, mended: Mended
) -> Frame:
    matrix = entry.get("transform_matrix")
    try:
        pose = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(file, f"no numbers in the transform_matrix of {name}", "a 4x4 matrix") from None
    depth_path = entry.get("depth_file_path")
    depth_path = None if depth_path is None else _inside(str(depth_path), file)
    unit = 1.0
    if depth_path is not None:
        default = _PNG_UNIT if depth_path.lower().endswith(".png") else 1.0
        unit = _number(content.get("depth_unit_scale_factor", default), "depth_unit_scale_factor", file)
    return Frame(
        name=name,
        file=image,
        intrinsics=_intrinsics({**content, **entry}, image, file),
        world_to_camera=invert(opengl_to_opencv(rigid(pose, file, name, mended))),
        depth_file=None if depth_path is None else root / depth_path,
        unit=unit,
        mask_file=None if entry.get("mask_path") is None else root / _inside(str(entry["mask_path"]), file),
    )


def _intrinsics(values: Mapping[str, Any], image: Path, file: Path) -> Intrinsics:
    def given(name: str) -> float | None:
        return None if values.get(name) is None else _number(values[name], name, file)

    def number(name: str, default: float = 0.0) -> float:
        value = given(name)
        return default if value is None else value

    model = values.get("camera_model") or ("OPENCV_FISHEYE" if values.get("is_fisheye") else "OPENCV")
    if model not in (*_FISHEYE, *_PERSPECTIVE):
        raise InputError(file, f"camera_model {model}", f"one of {', '.join([*_PERSPECTIVE, *_FISHEYE])}")
    width, height = given("w"), given("h")
    if width is None or height is None:
        width, height = image_size(image)
    if min(width, height) < 1 or width != int(width) or height != int(height):
        raise InputError(file, f"w {width}, h {height}", "whole pixels")
    fx, fy = _focal_lengths(given, width, height, file)
    if fx is None or fy is None or min(fx, fy) <= 0:
        expected = "fl_x or camera_angle_x, positive (axes that point the other way are turned in transform_matrix)"
        raise InputError(file, f"focal lengths {fx}, {fy} for {image.name}", expected)
    k1, k2, k3, k4, k5, k6, p1, p2 = (number(name) for name in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"))
    fisheye = model in _FISHEYE
    if not fisheye and k4 and model != "FULL_OPENCV":
        raise InputError(file, f"k4 {k4} for camera_model {model}", "k1 k2 k3 p1 p2, or OPENCV_FISHEYE")
    distortion = (k1, k2, k3, k4) if fisheye else (k1, k2, p1, p2, k3, k4, k5, k6)
    cx, cy = number("cx", width / 2), number("cy", height / 2)
    return Intrinsics(int(width), int(height), fx, fy, cx, cy, distortion, fisheye)


def _focal_lengths(
    given: Callable[[str], float | None], width: float, height: float, file: Path
) -> tuple[float | None, float | None]:
    """(fx, fy), pixels: fl_x, fl_y, else from the fields of view (radians); a missing one equals the other."""
    focal: list[float | None] = []
    for axis, size in (("x", width), ("y", height)):
        length, angle = given(f"fl_{axis}"), given(f"camera_angle_{axis}")
        if length is None and angle is not None and not 0 < angle < math.pi:
            expected = f"radians, more than 0 and less than pi{_degrees(angle)}"
            raise InputError(file, f"camera_angle_{axis} {angle:g}", expected)
        focal.append(0.5 * size / math.tan(0.5 * angle) if length is None and angle else length)
    fx, fy = focal
    if given("fl_x") is not None and given("fl_y") is None:
        # A field of view beside a focal length is derived from it, by whoever wrote the file, and less exact.
        fy = fx
    return (fy if fx is None else fx), (fx if fy is None else fy)


def _degrees(angle: float) -> str:
    return f" (were these degrees, {math.radians(angle):.4f})" if math.pi <= angle < 180 else ""


def _listed_paths(content: Mapping[str, Any], key: str, file: Path) -> set[str] | None:
    names = content.get(key)
    if names is None:
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(file, f"{key} that is no list of paths", "a list of the frames' file_path")
    paths = {_inside(name, file) for name in names}
    unknown = sorted(paths - {_path(frame, file) for frame in content["frames"]})
    if unknown:
        raise InputError(file, f"{listed(unknown)} in {key}, which no frame has", "a list of the frames' file_path")
    return paths


def listed_split(content: Mapping[str, Any], file: Path) -> FileSplit | None:
    """The lists of a transforms.json, for a scene read from another file; None without train and test lists.

    Raises InputError for wrong lists.
    """
    content = with_test_frames(content, file)
    lists = {part: _listed_paths(content, f"{part}_filenames", file) for part in _PARTS}
    if lists["train"] is None and lists["test"] is None:
        return None
    names = {part: tuple(sorted(paths)) for part, paths in lists.items() if paths is not None}
    return FileSplit(LISTS, file, names)


def _set_aside(content: Mapping[str, Any], file: Path) -> set[str]:
    """Views for validation only: neither trained on nor scored."""
    train, test = _listed_paths(content, "train_filenames", file), _listed_paths(content, "test_filenames", file)
    if train is None or test is None:
        return set()
    return (_listed_paths(content, "val_filenames", file) or set()) - train - test


def _splits(content: Mapping[str, Any], paths: Sequence[str], file: Path) -> dict[str, Split] | None:
    """Every path's split, by train_filenames and test_filenames, of which one implies the other; None without both."""
    train, test = _listed_paths(content, "train_filenames", file), _listed_paths(content, "test_filenames", file)
    if train is None:
        if test is None:
            return None
        train = set(paths) - test
    if test is None:
        test = set(paths) - train
    if train & test:
        raise InputError(file, f"{listed(sorted(train & test))} in both lists", "a view in one of train and test")
    nowhere = [path for path in paths if path not in train | test]
    if nowhere:
        raise InputError(file, f"{listed(nowhere)} in neither list", "every view in train_filenames or test_filenames")
    return {path: "test" if path in test else "train" for path in paths}


def _points(
    root: Path, content: Mapping[str, Any], paths: Sequence[str], frames: Sequence[Frame], file: Path
) -> tuple[PointCloud | None, Path, tuple[str, ...]]:
    """The points in the frame of the poses, tracks by frame; where they come from; and notes."""
    ply = content.get("ply_file_path")
    if ply is not None:
        # nerfstudio writes these points in the frame of transforms.json already.
        ply_file = root / _inside(str(ply), file)
        return read_ply(ply_file), ply_file, ()
    found = choose_model(root)
    if found is None:
        return None, file, ()
    scale = _number(content.get("applied_scale", 1.0), "applied_scale", file)
    poses = [frame.world_to_camera for frame in frames]
    model = read_found(found)
    return points_beside(model, content, scale, paths, poses, file), found.folder, model.notes
