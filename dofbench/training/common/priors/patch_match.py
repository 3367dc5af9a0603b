"""Depth from a dense workspace as stock COLMAP writes it: `image_undistorter`, `patch_match_stereo`, `stereo_fusion`.

Uses the geometric depth maps at the pixels that fusion kept. Stock COLMAP doesn't record these reliably, so each fused
point is projected into every view, and keeps the pixels whose own depth agrees with the point's.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from dofbench.core.cameras import NO_OFFSET, Camera
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.progress import Update, silent
from dofbench.scenes.depth_files import read_depth
from dofbench.scenes.local_frame import local_offset
from dofbench.scenes.ply import read_ply
from dofbench.scenes.readers.colmap import Model, read_model
from dofbench.scenes.readers.colmap_files import model_suffix
from dofbench.training.common.depth_map import DepthMap

SAME_DEPTH = 0.02  # relative: a fused point is a mean over views, and within this of each map that it was fused from
_ALIKE = 0.01  # relative difference of distances between cameras up to which two sets of poses agree up to a scale


def workspace_depth(folder: Path, training_set: TrainingSet, *, progress: Update = silent) -> list[DepthMap]:
    """One map per training view, scene units, 0 where fusion kept no point.

    folder: with sparse/, stereo/depth_maps/ and fused.ply. Views are found by name, without suffix. The workspace's
    images have intrinsics of their own: a training pixel takes the nearest workspace pixel along its ray. Raises
    InputError for files that are missing or wrong, missing views, and poses that differ by more than a similarity.
    """
    model = read_model(_model_folder(folder))
    places = _places(folder, model, training_set.views)
    cameras = [_camera(model, place) for place in places]
    unit = _scale(folder, training_set.views, cameras)
    fused = folder / "fused.ply"
    cloud = read_ply(fused)
    points = cloud.xyz
    if not len(points):
        raise InputError(fused, "no points", "what stereo_fusion kept")
    if local_offset(np.stack([camera.centre for camera in cameras]), cloud) != NO_OFFSET:
        raise InputError(folder, "coordinates far from their origin", "a workspace near it: COLMAP's is in float32")
    maps = []
    progress("depth prior: workspace", 0, len(places))
    for view, place, camera in zip(training_set.views, places, cameras, strict=True):
        depth = _geometric(folder, model.names[place], camera)
        kept = np.where(_fused(points, camera, depth), depth, 0)
        maps.append(_at_training_view(kept * unit, camera, view.camera))
        progress("depth prior: workspace", len(maps), len(places))
    return maps


def _model_folder(folder: Path) -> Path:
    if not folder.is_dir():
        raise InputError(folder, "no such folder", "a dense workspace of COLMAP's")
    found = next((place for place in (folder / "sparse", folder / "sparse/0") if model_suffix(place)), None)
    if found is None:
        raise InputError(folder, "no model in sparse/", "cameras, images, points3D (.bin or .txt)")
    return found


def _places(folder: Path, model: Model, views: tuple[TrainingView, ...]) -> list[int]:
    """The index of each training view's image in the model."""
    by_name: dict[str, list[int]] = {}
    for index, name in enumerate(model.names):
        path = PurePosixPath(name)
        for key in {path.with_suffix("").as_posix(), path.with_suffix("").name}:
            by_name.setdefault(key, []).append(index)
    missing = [view.name for view in views if view.name not in by_name]
    if missing:
        raise InputError(
            folder,
            f"no image of {len(missing)} of {len(views)} training views, such as {missing[0]}",
            "the images that the scene's cameras come from",
        )
    for view in views:
        if len(by_name[view.name]) > 1:
            names = ", ".join(model.names[index] for index in by_name[view.name])
            raise InputError(folder, f"{names} for view {view.name}", "one image a view")
    return [by_name[view.name][0] for view in views]


def _camera(model: Model, index: int) -> Camera:
    lens = model.intrinsics[index]
    if lens.distorted:
        raise InputError(model.folder, f"a distorted camera for {model.names[index]}", "undistorted images")
    return lens.camera(model.world_to_camera[index])


def _scale(folder: Path, views: tuple[TrainingView, ...], cameras: list[Camera]) -> float:
    """Scene units per unit of the workspace, from the distances between cameras alone."""
    own, others = (
        np.array([camera.centre for camera in every]) for every in ([view.camera for view in views], cameras)
    )
    first, second = np.triu_indices(len(own), 1)
    distances = [np.linalg.norm(centres[first] - centres[second], axis=1) for centres in (own, others)]
    far = distances[1] > 0.1 * distances[1].max(initial=0)
    if not far.any():
        return 1.0
    ratio = distances[0][far] / distances[1][far]
    scale = float(np.median(ratio))
    worst = float(np.abs(ratio / scale - 1).max()) if scale > 0 else np.inf
    if worst > _ALIKE:
        raise InputError(
            folder,
            f"cameras whose distances differ from the scene's by up to {100 * worst:.0f} %",
            "the scene's own poses, up to a similarity",
        )
    return scale


def _geometric(folder: Path, name: str, camera: Camera) -> np.ndarray:
    """The geometric depth map of an image, at the camera's size; negative values and infinity are unknown."""
    file = folder / "stereo" / "depth_maps" / f"{name}.geometric.bin"
    if not file.is_file():
        raise InputError(file, "no such file", "a map of patch_match_stereo's with geom_consistency")
    depth = read_depth(file, 1.0)
    height, width = depth.shape
    # patch_match_stereo may have used smaller images of the same aspect ratio.
    if abs(width / camera.width - height / camera.height) > 1.5 / min(camera.width, camera.height):
        raise InputError(file, f"{width}x{height} pixels", f"the shape of {camera.width}x{camera.height}")
    rows = ((np.arange(camera.height) + 0.5) * height / camera.height).astype(np.int64)
    columns = ((np.arange(camera.width) + 0.5) * width / camera.width).astype(np.int64)
    return depth[rows[:, None], columns]


def _fused(points: np.ndarray, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels whose depth agrees with a fused point that is projected into them or a neighbour.

    The depth of a hidden point doesn't agree. Neighbours count, since a point fused from several views is projected
    between the pixels of each.
    """
    xy, z = camera.project(points)
    seen = camera.inside(xy)
    columns, rows = xy[seen].astype(np.int64).T
    kept = np.zeros(depth.shape, dtype=bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            row, column = np.clip(rows + down, 0, camera.height - 1), np.clip(columns + right, 0, camera.width - 1)
            own = depth[row, column]
            same = (own > 0) & (np.abs(z[seen] - own) <= SAME_DEPTH * own)
            kept[row[same], column[same]] = True
    return kept


def _at_training_view(depth: np.ndarray, camera: Camera, goal: Camera) -> DepthMap:
    """The map resampled to the pixels of the training view, whose camera differs in its intrinsics alone."""
    x, y = goal.rays(np.arange(goal.width) + 0.5, np.arange(goal.height) + 0.5)
    x, y = x * camera.fx + camera.cx, y * camera.fy + camera.cy
    inside = ((y >= 0) & (y < camera.height))[:, None] & ((x >= 0) & (x < camera.width))
    columns = np.clip(x, 0, camera.width - 1).astype(np.int64)
    rows = np.clip(y, 0, camera.height - 1).astype(np.int64)
    found = np.where(inside, depth[rows[:, None], columns], 0).astype(np.float32)
    return DepthMap(found, None)
