"""Map matches to camera poses and points, incrementally or globally, or to points alone where poses are known."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from dofbench.scenes.reconstruction.kept_steps import wait
from dofbench.scenes.reconstruction.photograph_list import LEAST, Prepared
from dofbench.scenes.reconstruction.reconstruct_options import Mapping

# The second attempt's demands, for photographs with few features in common: half of COLMAP's own, and smaller angles.
_LENIENT = {"init_min_num_inliers": 40, "init_min_tri_angle": 6.0, "abs_pose_min_num_inliers": 15}
# With this share of the photographs placed there is no second attempt.
_ENOUGH = 0.95


@dataclass(frozen=True, eq=False)
class Mapped:
    """model: the pycolmap.Reconstruction with the most photographs. others: file names of each further connected part.
    attempt: whose thresholds it met."""

    model: Any
    others: tuple[tuple[str, ...], ...]
    attempt: str


def map_photographs(
    database: Path,
    folder: Path,
    work: Path,
    count: int,
    *,
    mapping: Mapping,
    seed: int,
    advance: Callable[[int], None],
    sign: Callable[[], None],
) -> Mapped | None:
    """Poses of the connected photographs, `count` at most; None for fewer than three.

    One thread and one seed: the same database gives the same bits. advance: called with the photographs placed so far.
    sign: called often while progress is unknown.
    """
    if mapping == "global":
        return _largest(wait(lambda: _global(database, folder, work, seed), sign), "COLMAP's own")
    best: Mapped | None = None
    for attempt, demands in (("COLMAP's own", {}), ("lenient", _LENIENT)):
        placed = _Placed(advance, count)
        found = _largest(
            wait(partial(_incremental, database, folder, work, seed, demands, placed), placed.look), attempt
        )
        if found is not None and (best is None or found.model.num_reg_images() > best.model.num_reg_images()):
            best = found
        if best is not None and best.model.num_reg_images() >= _ENOUGH * count:
            break
    return best


class _Placed:
    """Counts photographs as COLMAP's thread places them; the main thread shows the count."""

    def __init__(self, advance: Callable[[int], None], most: int):
        self._advance, self._most, self._count = advance, most, 0

    def begin(self) -> None:
        """Count the two photographs that a model begins with."""
        self._count = 2

    def one_more(self) -> None:
        """Count the next photograph."""
        self._count += 1

    def look(self) -> None:
        """Show the count."""
        self._advance(min(self._count, self._most))


def _incremental(
    database: Path, folder: Path, work: Path, seed: int, demands: dict[str, float], placed: _Placed
) -> dict[int, Any]:
    from dofbench.scenes.colmap_binding import pycolmap

    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = 1, seed, LEAST
    options.mapper.num_threads = 1
    options.mapper.random_seed = options.triangulation.random_seed = seed
    for name, value in demands.items():
        setattr(options.mapper, name, value)
    pycolmap.set_random_seed(seed)
    return pycolmap.incremental_mapping(
        database,
        folder,
        _emptied(work),
        options=options,
        initial_image_pair_callback=placed.begin,
        next_image_callback=placed.one_more,
    )


def _global(database: Path, folder: Path, work: Path, seed: int) -> dict[int, Any]:
    from dofbench.scenes.colmap_binding import pycolmap

    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed, options.min_model_size = 1, seed, LEAST
    mapper = options.mapper
    for part in (mapper, mapper.rotation_averaging, mapper.global_positioning, mapper.retriangulation):
        part.random_seed = seed
    options.mapper.num_threads = 1
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    pycolmap.set_random_seed(seed)
    return pycolmap.global_mapping(database, folder, _emptied(work), options=options)


def _largest(models: dict[int, Any], attempt: str) -> Mapped | None:
    """The model with the most photographs, then points; None where it has fewer than three."""
    order = sorted(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()), reverse=True)
    if not order or order[0].num_reg_images() < LEAST or not order[0].num_points3D():
        return None
    registered = {order[0].images[key].name for key in order[0].reg_image_ids()}
    others = []
    for model in order[1:]:
        names = tuple(sorted({model.images[key].name for key in model.reg_image_ids()} - registered))
        if len(names) >= LEAST:
            others.append(names)
    return Mapped(order[0], tuple(others), attempt)


def triangulate(
    database: Path,
    folder: Path,
    work: Path,
    photographs: Sequence[Prepared],
    seed: int,
    sign: Callable[[], None],
    *,
    error: float | None = None,
    narrow: bool = False,
) -> Any:
    """Triangulate points (a pycolmap.Reconstruction) of photographs with fixed poses.

    As COLMAP, excludes tracks of an angle below 1.5 degrees or an error above 4 pixels. sign: called often meanwhile.
    error: pixels in place of these 4, and the angle of twice as many in place of COLMAP's 2 degrees between a ray and
    its point. narrow: the same angle in place of 1.5 degrees too, for cameras that are close together.
    """
    from dofbench.scenes.colmap_binding import pycolmap

    with pycolmap.Database.open(database) as opened:
        images = {image.name: image for image in opened.read_all_images()}
        cameras = {camera.camera_id: camera for camera in opened.read_all_cameras()}
    posed = pycolmap.Reconstruction()
    for photograph in photographs:
        image = images[photograph.file_name]
        camera = photograph.camera
        assert camera is not None
        if image.camera_id not in posed.cameras:
            posed.add_camera_with_trivial_rig(cameras[image.camera_id])
        posed.add_image_with_trivial_frame(
            pycolmap.Image(photograph.file_name, camera_id=image.camera_id, image_id=image.image_id),
            pycolmap.Rigid3d(camera.world_to_camera[:3]),
        )
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = 1, seed
    options.triangulation.random_seed = seed
    if error is not None:
        options.mapper.filter_max_reproj_error = error
        options.triangulation.merge_max_reproj_error = options.triangulation.complete_max_reproj_error = error
        focal = min(camera.mean_focal_length() for camera in posed.cameras.values())
        angle = math.degrees(math.atan(2 * error / focal))
        options.triangulation.create_max_angle_error = options.triangulation.continue_max_angle_error = angle
        if narrow:
            options.triangulation.min_angle = options.mapper.filter_min_tri_angle = angle
    return wait(lambda: pycolmap.triangulate_points(posed, database, folder, _emptied(work), options=options), sign)


def _emptied(work: Path) -> Path:
    folder = work / "models"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
