"""COLMAP models, binary or text, and the layout `images/` + `sparse/0` that 3DGS reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.scenes.colmap_files import check_binary, check_kinds, model_suffix
from dofbench.scenes.folders import choose_folder, match_files
from dofbench.scenes.poses import rigid
from dofbench.scenes.scene import Scene
from dofbench.scenes.undistort import Intrinsics
from dofbench.scenes.views import Frame, assemble, held_out

if TYPE_CHECKING:
    import pycolmap

# Pixels; no sensor has so many on a side.
_LARGEST_SIDE = 1_000_000
_PLACES = ("sparse/0", "sparse")
# pycolmap's messages may quote whole lines of its source.
_REASON = 120
# Where each of OpenCV's coefficients k1 k2 p1 p2 k3 k4 k5 k6 stands among a model's parameters, after its
# focal lengths and principal point (COLMAP's sensor/models.h); fisheye models have k1 k2 k3 k4.
_PERSPECTIVE = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 0,
    "SIMPLE_RADIAL": 1,
    "RADIAL": 2,
    "OPENCV": 4,
    "FULL_OPENCV": 8,
}
_FISHEYE = {"SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 2, "OPENCV_FISHEYE": 4}
_TWO_FOCALS = ("PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE")


@dataclass(frozen=True, eq=False)
class Model:
    """A COLMAP model in plain arrays.

    folder: where it was. names: of the posed images, sorted. intrinsics, world_to_camera: one an
    image. points: sorted by their id; points.views index into `names`. None without points.
    """

    folder: Path
    names: tuple[str, ...]
    intrinsics: tuple[Intrinsics, ...]
    world_to_camera: tuple[np.ndarray, ...]
    points: PointCloud | None


def find_model(root: Path) -> Path | None:
    """The folder with a COLMAP model under a scene folder: sparse/0, else sparse; None without one."""
    return next((root / place for place in _PLACES if model_suffix(root / place)), None)


def scene_folder(folder: Path) -> Path:
    """The scene's folder where `folder` is the place of its model, sparse or sparse/0; else `folder` itself."""
    here = folder.resolve()
    for scene in (here.parent, here.parent.parent):
        model = find_model(scene)
        if model is not None and here in (model, scene / "sparse"):
            return scene
    return folder


def fits(root: Path) -> bool:
    """Whether the folder has a COLMAP model."""
    return find_model(root) is not None


def read(root: Path, *, width: int | None, images: str | None, hold: int | None) -> Scene:
    """Read the layout; see `load_scene`."""
    folder = find_model(root)
    if folder is None:
        raise InputError(root, f"no COLMAP model in {' or '.join(_PLACES)}", "cameras, images, points3D (.bin or .txt)")
    model = read_model(folder)
    image_folder = choose_folder(root, width=width, images=images, habit=(1, 2, 4, 8))
    files = match_files(image_folder, model.names, folder, by_order=(root / "poses_bounds.npy").is_file())
    frames = [
        Frame(file.relative_to(image_folder).as_posix(), file, intrinsics, pose)
        for file, intrinsics, pose in zip(files, model.intrinsics, model.world_to_camera, strict=True)
    ]
    return held_out(assemble(root, "colmap", frames, model.points, width=width, subject=folder), hold)


def read_model(folder: Path) -> Model:
    """Read cameras, posed images and points. Raises InputError for damaged files and unsupported camera models."""
    import pycolmap

    suffix = model_suffix(folder)
    if suffix is None:
        raise InputError(folder, "no COLMAP model", "cameras, images, points3D (.bin or .txt)")
    check_kinds(folder)
    if suffix == ".bin":
        check_binary(folder)
    reconstruction = pycolmap.Reconstruction()
    try:
        reconstruction.read_binary(str(folder)) if suffix == ".bin" else reconstruction.read_text(str(folder))
    except (RuntimeError, ValueError, IndexError, TypeError, MemoryError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        found = f"no readable COLMAP model ({reason[:_REASON]})"
        raise InputError(folder, found, f"consistent {suffix} files") from None
    try:
        names = {image.image_id: image.name for image in reconstruction.images.values() if image.has_pose}
    except UnicodeDecodeError as error:
        found = f"an image's name that isn't UTF-8 ({error.object!r:.80})"
        raise InputError(folder / f"images{suffix}", found, "names in UTF-8") from None
    posed = [reconstruction.images[number] for number in sorted(names, key=names.__getitem__)]
    if not posed:
        raise InputError(folder / f"images{suffix}", "no image with a pose", "at least one")
    cameras_file, images_file = folder / f"cameras{suffix}", folder / f"images{suffix}"
    lenses = {key: _intrinsics(camera, cameras_file) for key, camera in reconstruction.cameras.items()}
    return Model(
        folder=folder,
        names=tuple(image.name for image in posed),
        intrinsics=tuple(lenses[image.camera_id] for image in posed),
        world_to_camera=tuple(rigid(image.cam_from_world().matrix(), images_file, image.name) for image in posed),
        points=_points(reconstruction, [image.image_id for image in posed], folder / f"points3D{suffix}"),
    )


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
        np.unique(np.array([rank[e.image_id] for e in point.track.elements if e.image_id in rank], dtype=np.int64))
        for point in rows
    )
    rgb = np.array([point.color for point in rows], dtype=np.float32) / np.float32(255.0)
    return PointCloud(xyz, rgb, error, tracks if any(len(track) for track in tracks) else None)
