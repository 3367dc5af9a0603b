"""COLMAP models, binary or text, and the layout `images/` + `sparse/0` that 3DGS reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.cameras import NO_OFFSET
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.scenes.local_frame import AnotherFrame, local_offset
from dofbench.scenes.readers.colmap_files import (
    binary_poses,
    check_binary,
    check_kinds,
    count_images,
    model_suffix,
    readable_text,
)
from dofbench.scenes.readers.colmap_places import PLACES, FoundModel, choose_model, find_model
from dofbench.scenes.readers.folders import (
    choose_folder,
    fewer_points,
    find_matches,
    listed,
    other_format,
    refuse_missing,
    skipped,
    without_pose,
)
from dofbench.scenes.readers.name_match import plain_inside
from dofbench.scenes.readers.poses import invert, rigid
from dofbench.scenes.scene import Scene
from dofbench.scenes.undistort import Intrinsics
from dofbench.scenes.views import Frame, among_all, assemble, check_inside, held_out

if TYPE_CHECKING:
    from dofbench.scenes.colmap_binding import pycolmap

# Pixels; no sensor has so many on a side.
_LARGEST_SIDE = 1_000_000
# Of a pose that two files have, in entries of the rotation and relative to positions: more isn't rounding.
_ONE_POSE = 1e-4
# pycolmap's messages may quote whole lines of its source.
_REASON = 120
# Where each of OpenCV's coefficients k1 k2 p1 p2 k3 k4 k5 k6 stands among a model's parameters, after its
# focal lengths and principal point (COLMAP's sensor/models.h); fisheye models have k1 k2 k3 k4.
_PERSPECTIVE = {"SIMPLE_PINHOLE": 0, "PINHOLE": 0, "SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4, "FULL_OPENCV": 8}
_FISHEYE = {"SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 2, "OPENCV_FISHEYE": 4}
# Median reprojection error, pixels, beyond twice what a model says of itself, from which on it is named.
_MISSED = 1.0
_TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE")


@dataclass(frozen=True, eq=False)
class Model:
    """A COLMAP model in plain arrays.

    names: of the posed images, sorted. intrinsics, world_to_camera: one an image. points: sorted by id, None without;
    points.views index into `names`. notes: for `Scene.noted`.
    """

    folder: Path
    names: tuple[str, ...]
    intrinsics: tuple[Intrinsics, ...]
    world_to_camera: tuple[np.ndarray, ...]
    points: PointCloud | None
    notes: tuple[str, ...] = ()

    def noted(self, notes: Sequence[str]) -> Model:
        """The model with these notes before its own."""
        return replace(self, notes=(*notes, *self.notes))

    def only(self, images: Sequence[int]) -> Model:
        """The model of these images alone, in order, with the points that they saw."""
        if len(images) == len(self.names):
            return self
        return replace(
            self,
            names=tuple(self.names[index] for index in images),
            intrinsics=tuple(self.intrinsics[index] for index in images),
            world_to_camera=tuple(self.world_to_camera[index] for index in images),
            points=None if self.points is None else self.points.seen_by(images),
        )


def fits(root: Path) -> bool:
    """Whether the folder has a COLMAP model."""
    return find_model(root) is not None


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`."""
    found = choose_model(root)
    if found is None:
        raise InputError(root, f"no COLMAP model in {PLACES}", "cameras, images, points3D (.bin or .txt)")
    model = read_found(found)
    image_folder = choose_folder(root, width=width, images=images, habit=(1, 2, 4, 8), base=found.images)
    renumbered = (root / "poses_bounds.npy").is_file()
    matched = find_matches(image_folder, model.names, found.folder, by_order=renumbered)
    if not skip_missing or not matched.present():
        refuse_missing(image_folder, model.names, matched, found.folder)
    kept = model.only(matched.present())
    files = matched.found()
    frames = [
        Frame(file.relative_to(image_folder).as_posix(), file, intrinsics, pose)
        for file, intrinsics, pose in zip(files, kept.intrinsics, kept.world_to_camera, strict=True)
    ]
    place = found.folder.relative_to(root)
    scene = assemble(root, "colmap", frames, kept.points, width=width, subject=found.folder).noted(
        *kept.notes,
        skipped(model.names, matched, place),
        fewer_points(model.points, kept.points),
        without_pose(image_folder, files, place),
        other_format(matched, image_folder, place),
    )
    if scene.offset != NO_OFFSET:
        try:
            check_inside(scene, found.folder)
        except AnotherFrame as error:
            expected = f"{error.expected}; so far from the origin, rotations need all of their digits"
            raise InputError(error.subject, error.found, expected) from None
    absent, called = matched.missing(model.names), dict(zip(files, kept.names, strict=True))
    return held_out(among_all(scene, called, absent), hold, called, absent)


def read_found(found: FoundModel) -> Model:
    """Read the chosen model, and note the choice. Raises InputError as `read_model`."""
    return read_model(found.folder).noted([found.choice] if found.choice else ())


def read_model(folder: Path) -> Model:
    """Read cameras, posed images and points. Raises InputError for damaged files and unsupported camera models."""
    suffix = model_suffix(folder)
    if suffix is None:
        raise InputError(folder, "no COLMAP model", "cameras, images, points3D (.bin or .txt)")
    check_kinds(folder)
    if suffix == ".bin":
        check_binary(folder)
        poses = binary_poses(folder)
        return _model(folder, suffix, folder, {}, poses).noted(_other_text(folder, len(poses)))
    with readable_text(folder) as text:
        return _model(folder, suffix, text.folder, text.names, text.poses).noted(text.notes)


def _other_text(folder: Path, images: int) -> tuple[str, ...]:
    """A note on a text model next to the binary one that has another number of images."""
    try:
        others = count_images(folder) if (folder / "images.txt").is_file() else images
    except InputError:
        return ()
    note = f"{images} images in images.bin, {others} in images.txt: the binary model is read"
    return (note,) if others != images else ()


def _model(
    folder: Path, suffix: str, place: Path, names: Mapping[int, str], poses: Mapping[int, Sequence[float]]
) -> Model:
    """Read the model whose files are in `place`. names: of its images, where pycolmap cuts them. poses: quaternion and
    translation in the file of images, which pycolmap ignores where there is one of frames."""
    from dofbench.scenes.colmap_binding import pycolmap

    reconstruction = pycolmap.Reconstruction()
    try:
        reconstruction.read_binary(str(place)) if suffix == ".bin" else reconstruction.read_text(str(place))
    except (RuntimeError, ValueError, IndexError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        found = f"no readable COLMAP model ({reason[:_REASON]})"
        raise InputError(folder, found, f"consistent {suffix} files") from None
    cameras_file, images_file = folder / f"cameras{suffix}", folder / f"images{suffix}"
    with_pose = [image for image in reconstruction.images.values() if image.has_pose]
    try:
        written = {image.image_id: names[image.image_id] if names else image.name for image in with_pose}
    except UnicodeDecodeError as error:
        found = f"an image's name that isn't UTF-8 ({error.object!r:.80})"
        raise InputError(images_file, found, "names in UTF-8") from None
    called = {key: plain_inside(name, images_file) for key, name in written.items()}
    if not called:
        raise InputError(images_file, "no image with a pose", "at least one")
    if len(set(called.values())) < len(called):
        twice = sorted(name for name, count in Counter(called.values()).items() if count > 1)
        raise InputError(images_file, f"several images called {listed(twice)}", "one image a name")
    for image in with_pose if (folder / f"frames{suffix}").is_file() else ():
        _check_pose(image, poses[image.image_id], called[image.image_id], images_file)
    posed = [reconstruction.images[key] for key in sorted(called, key=called.__getitem__)]
    lenses = {key: _intrinsics(camera, cameras_file) for key, camera in reconstruction.cameras.items()}
    names_of = tuple(called[image.image_id] for image in posed)
    intrinsics = tuple(lenses[image.camera_id] for image in posed)
    matrices = [image.cam_from_world().matrix() for image in posed]
    rotations = tuple(rigid(matrix, images_file, name) for matrix, name in zip(matrices, names_of, strict=True))
    points_file = folder / f"points3D{suffix}"
    points = _points(reconstruction, [image.image_id for image in posed], points_file)
    if local_offset(np.stack([invert(pose)[:3, 3] for pose in rotations]), points) != NO_OFFSET:
        notes = [_misplaced(reconstruction)]
    else:
        count = len(reconstruction.images)
        without = f"{count} images in {images_file.name}, {count - len(posed)} without a pose: skipped"
        notes = [without if len(posed) < count else "", _missing_points(reconstruction, points_file)]
    return Model(folder, names_of, intrinsics, rotations, points, tuple(filter(None, notes)))


def _misplaced(reconstruction: pycolmap.Reconstruction) -> str:
    """A note where points of a model far from its origin miss their recorded image positions.

    A camera's position is computed from its rotation, times the distance of the origin: in a UTM zone seven digits of
    the rotation put it half a metre off.
    """

    def median_error() -> float:
        known = [point.error for point in reconstruction.points3D.values() if point.error >= 0]
        return float(np.median(known)) if known else 0.0

    before = median_error()
    reconstruction.update_point_3d_errors()
    after = median_error()
    if after <= 2 * before + _MISSED:
        return ""
    return (
        f"points miss their recorded image positions by {after:.3g} pixels (median), {before:.3g} as the model says: "
        "so far from the origin, rotations of few digits misplace cameras"
    )


def _missing_points(reconstruction: pycolmap.Reconstruction, file: Path) -> str:
    """A note on points that images saw and their own file lacks: it may have been cut or filtered."""
    seen = sum(image.num_points3D for image in reconstruction.images.values())
    tracked = sum(point.track.length() for point in reconstruction.points3D.values())
    count = len(reconstruction.points3D)
    note = f"{file.name} has {count} points, with {tracked} of the {seen} sightings in the images"
    return note if seen > tracked else ""


def _check_pose(image: pycolmap.Image, pose: Sequence[float], name: str, file: Path) -> None:
    """Raise InputError unless an image's pose in its file is the one that its frame and its rig give."""
    from dofbench.scenes.colmap_binding import pycolmap

    quaternion, translation = np.array(pose[:4]), pose[4:]
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    written = np.column_stack([pycolmap.Rotation3d(np.array([x, y, z, w])).matrix(), translation])
    composed = image.cam_from_world().matrix()
    if not np.abs(written - composed).max() <= _ONE_POSE * max(1.0, np.abs(composed).max()):
        raise InputError(file, f"another pose of {name} than in {file.with_stem('frames').name}", "one pose an image")


def _intrinsics(camera: pycolmap.Camera, subject: Path) -> Intrinsics:
    name, values = camera.model_name, [float(value) for value in camera.params]
    fisheye = name in _FISHEYE
    if not fisheye and name not in _PERSPECTIVE:
        raise InputError(subject, f"camera model {name}", f"one of {', '.join([*_PERSPECTIVE, *_FISHEYE])}")
    sides = sorted((camera.width, camera.height))
    if not np.isfinite(values).all() or not 1 <= sides[0] <= sides[1] <= _LARGEST_SIDE:
        raise InputError(subject, f"camera {camera.camera_id}: {camera.width}x{camera.height}, {values}", "a camera")
    focals = 2 if name in _TWO_FOCALS else 1
    fx, fy = values[0], values[focals - 1]
    if min(fx, fy) <= 0:
        raise InputError(subject, f"focal lengths {fx}, {fy}", "positive ones, pixels")
    cx, cy, *distortion = values[focals:]
    if len(distortion) != {**_PERSPECTIVE, **_FISHEYE}[name]:
        raise InputError(subject, f"{len(values)} parameters for {name}", "the number that COLMAP gives this model")
    return Intrinsics(camera.width, camera.height, fx, fy, cx, cy, tuple(distortion), fisheye)


def _points(reconstruction: pycolmap.Reconstruction, image_ids: Sequence[int], subject: Path) -> PointCloud | None:
    if not reconstruction.points3D:
        return None
    rank = {key: index for index, key in enumerate(image_ids)}
    rows = [reconstruction.points3D[key] for key in sorted(reconstruction.points3D)]
    xyz = np.array([point.xyz for point in rows], dtype=np.float64)
    if not np.isfinite(xyz).all():
        raise InputError(subject, "points with NaN or infinity", "finite coordinates")
    error = np.array([point.error for point in rows], dtype=np.float32)
    # COLMAP writes -1 where it doesn't know the error.
    error[error < 0] = np.nan
    tracks = tuple(
        np.array(sorted({rank[e.image_id] for e in point.track.elements if e.image_id in rank}), dtype=np.int64)
        for point in rows
    )
    rgb = np.array([point.color for point in rows], dtype=np.float32) / np.float32(255.0)
    return PointCloud(xyz, rgb, error, tracks if any(len(track) for track in tracks) else None)
