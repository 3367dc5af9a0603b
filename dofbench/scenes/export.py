"""Write cameras and points as COLMAP, LLFF and nerfstudio read them, atomically and reproducibly."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.cameras import NO_OFFSET, Camera, Offset
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.files import TEMPORARY, refused, replacing, write_json
from dofbench.core.images import to_8bit
from dofbench.scenes.readers.colmap_files import check_binary
from dofbench.scenes.readers.poses import opencv_to_llff, opengl_to_opencv
from dofbench.scenes.scene import Split

_MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin")


def write_colmap(
    root: Path,
    file_names: Sequence[str],
    cameras: Sequence[Camera],
    points: PointCloud | None,
    offset: Offset = NO_OFFSET,
) -> None:
    """Write `root/sparse/0/{cameras,images,points3D}.bin`, without the rig and frame files, which older readers don't
    know.

    file_names: of the images, relative to their folder. One PINHOLE camera for every distinct size and intrinsics; ids
    count from 1 in order. points.views, where known, index the views: they become tracks with the projections as 2D
    points. offset: added to all positions.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    _check_equal(len(file_names), len(cameras), "file_names", "cameras")
    model = pycolmap.Reconstruction()
    lens_ids: dict[tuple[float, ...], int] = {}
    sightings = _sightings(points, len(cameras))
    for index, (name, camera) in enumerate(zip(file_names, cameras, strict=True)):
        lens = (camera.width, camera.height, *camera.parameters)
        if lens not in lens_ids:
            lens_ids[lens] = len(lens_ids) + 1
            model.add_camera_with_trivial_rig(
                pycolmap.Camera(
                    camera_id=lens_ids[lens], model="PINHOLE", width=lens[0], height=lens[1], params=list(lens[2:])
                )
            )
        pixels = np.empty((0, 2))
        if points is not None and len(sightings[index]):
            pixels, _ = camera.project(points.xyz[sightings[index]])
            if not np.isfinite(pixels).all():
                raise ValueError(f"points.views: view {index} ({name}) sees a point behind its camera")
        image = pycolmap.Image(name, pixels, camera_id=lens_ids[lens], image_id=index + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.moved(offset).world_to_camera[:3]))
    if points is not None:
        _add_points(model, points.moved(offset), sightings)
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f"{TEMPORARY}model.", dir=folder) as unfinished:
        model.write_binary(unfinished)
        try:
            check_binary(Path(unfinished))
        except InputError as cut_short:  # pycolmap doesn't notice that a write failed
            raise refused(folder, Path(unfinished, _MODEL_FILES[0]), cut_short.found) from None
        for name in _MODEL_FILES:
            with replacing(folder / name) as temporary:
                temporary.write_bytes(Path(unfinished, name).read_bytes())


def write_poses_bounds(
    path: Path, cameras: Sequence[Camera], near_far: np.ndarray, offset: Offset = NO_OFFSET
) -> list[str]:
    """Write LLFF's `poses_bounds.npy`: (N, 17) float64, cameras in the order of the sorted image files.

    near_far: (N, 2), scene units. The layout has one focal length, here the mean of fx and fy, and the principal point
    in the middle; returns a note for each kind of loss. offset: added to all positions.
    """
    near_far = np.asarray(near_far, dtype=np.float64)
    if near_far.shape != (len(cameras), 2):
        raise ValueError(f"near_far: expected shape ({len(cameras)}, 2), found {near_far.shape}")
    rows = np.empty((len(cameras), 17))
    for row, camera, bounds in zip(rows, cameras, near_far, strict=True):
        size = (camera.height, camera.width, 0.5 * (camera.fx + camera.fy))
        row[:15] = np.column_stack([opencv_to_llff(camera.moved(offset).camera_to_world), size]).ravel()
        row[15:] = bounds
    with replacing(path) as temporary, temporary.open("wb") as stream:
        np.save(stream, rows)
    stretch = max((abs(camera.fx / camera.fy - 1) for camera in cameras), default=0.0)
    off_middle = max((max(abs(c.cx - c.width / 2), abs(c.cy - c.height / 2)) for c in cameras), default=0.0)
    notes = []
    if stretch > 0:
        notes.append(f"{path.name}: fx and fy differ by up to {stretch:.3%}; LLFF has one focal length, their mean")
    if off_middle > 0:
        notes.append(f"{path.name}: principal points up to {off_middle:.3g} px off the middle, where LLFF has them")
    return notes


def write_transforms(
    path: Path,
    file_paths: Sequence[str],
    cameras: Sequence[Camera],
    *,
    depth_paths: Sequence[str | None] | None = None,
    splits: Sequence[Split] | None = None,
    extra: Sequence[Mapping[str, Any]] | None = None,
    ply_path: str | None = None,
    offset: Offset = NO_OFFSET,
) -> None:
    """Write nerfstudio's `transforms.json`, with OpenGL camera axes; paths are relative to its folder.

    Intrinsics that all cameras share are written once. depth_paths: z-depth in scene units, float EXR; None for a view
    without. splits: give train_filenames and test_filenames. extra: more entries for each frame, which must not clash.
    offset: added to all positions.
    """
    _check_equal(len(file_paths), len(cameras), "file_paths", "cameras")
    lenses = [_lens(camera) for camera in cameras]
    shared = lenses[0] if lenses and all(lens == lenses[0] for lens in lenses) else {}
    content: dict[str, Any] = {"camera_model": "PINHOLE", **shared}
    if depth_paths is not None:
        _check_equal(len(depth_paths), len(cameras), "depth_paths", "cameras")
        if any(path is not None for path in depth_paths):
            content["depth_unit_scale_factor"] = 1.0
    if ply_path is not None:
        content["ply_file_path"] = ply_path
    frames = []
    for index, (file_path, camera) in enumerate(zip(file_paths, cameras, strict=True)):
        frame = {"file_path": file_path, **({} if shared else lenses[index])}
        frame["transform_matrix"] = opengl_to_opencv(camera.moved(offset).camera_to_world).tolist()
        if depth_paths is not None and depth_paths[index] is not None:
            frame["depth_file_path"] = depth_paths[index]
        if extra is not None:
            clash = sorted(frame.keys() & extra[index].keys())
            if clash:
                raise ValueError(f"extra: {', '.join(clash)} belong to the layout")
            frame |= extra[index]
        frames.append(frame)
    content["frames"] = frames
    if splits is not None:
        _check_equal(len(splits), len(cameras), "splits", "cameras")
        for wanted in ("train", "test"):
            content[f"{wanted}_filenames"] = [
                name for name, split in zip(file_paths, splits, strict=True) if split == wanted
            ]
    write_json(path, content)


def _lens(camera: Camera) -> dict[str, float]:
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": float(camera.fx),
        "fl_y": float(camera.fy),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
    }


def _sightings(points: PointCloud | None, views: int) -> list[np.ndarray]:
    """The points that each view saw, by index, in order; empty where tracks are unknown."""
    if points is None or points.views is None:
        return [np.empty(0, dtype=np.int64)] * views
    lengths = [len(track) for track in points.views]
    seen_by = np.concatenate([np.asarray(track, dtype=np.int64) for track in points.views] or [np.empty(0, np.int64)])
    if len(seen_by) and not (0 <= seen_by.min() and seen_by.max() < views):
        raise ValueError(f"points.views: expected indices from 0 to {views - 1}")
    which = np.repeat(np.arange(len(points)), lengths)
    order = np.argsort(seen_by, kind="stable")
    ends = np.searchsorted(seen_by[order], np.arange(views + 1))
    return [which[order[ends[view] : ends[view + 1]]] for view in range(views)]


def _add_points(model: Any, points: PointCloud, sightings: Sequence[np.ndarray]) -> None:
    from dofbench.scenes.colmap_binding import pycolmap

    tracks: list[list[pycolmap.TrackElement]] = [[] for _ in range(len(points))]
    for view, seen in enumerate(sightings):
        for place, point in enumerate(seen):
            tracks[point].append(pycolmap.TrackElement(view + 1, place))
    rgb = to_8bit(points.rgb)
    error = np.where(np.isfinite(points.error), points.error, -1.0)
    for index, track in enumerate(tracks):
        point = pycolmap.Point3D(xyz=points.xyz[index], color=rgb[index], error=float(error[index]))
        point.track = pycolmap.Track(track)
        model.add_point3D_with_id(index + 1, point)


def _check_equal(found: int, expected: int, name: str, other: str) -> None:
    if found != expected:
        raise ValueError(f"{name}: expected {expected}, as many as {other}, found {found}")


_NEAR_FAR = (0.1, 99.9)  # percentiles of depth that are LLFF's near and far bounds


def view_bounds(known: np.ndarray) -> tuple[float, float]:
    """LLFF near and far bounds of a view's known depths, scene units; NaN if there is none."""
    near, far = np.percentile(known, _NEAR_FAR) if known.size else (np.nan, np.nan)
    return float(near), float(far)


def depth_bounds(views: Iterable[tuple[float, float]]) -> np.ndarray | None:
    """(N, 2) LLFF near and far bounds of N views, of which `view_bounds` gives each; None if no view has any.

    A view without any gets the nearest and the farthest bound of all views.
    """
    bounds = np.array(list(views), dtype=np.float64).reshape(-1, 2)
    told = np.isfinite(bounds[:, 0])
    if not told.any():
        return None
    bounds[~told] = bounds[told, 0].min(), bounds[told, 1].max()
    return bounds
