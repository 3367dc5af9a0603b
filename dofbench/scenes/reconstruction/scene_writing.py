"""The scene: photographs without distortion, pinhole cameras, points with tracks, EXIF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dofbench.core.cameras import NO_OFFSET, Camera, Offset
from dofbench.core.contracts import PointCloud
from dofbench.core.image_files.exif import write_exif
from dofbench.core.images import read_exr, read_image, write_exr, write_png
from dofbench.core.masks import read_mask, write_mask
from dofbench.scenes import export
from dofbench.scenes.readers.colmap import read_model
from dofbench.scenes.reconstruction.kept_steps import Work
from dofbench.scenes.reconstruction.photograph_list import Prepared
from dofbench.scenes.scene_masks import undistort_mask
from dofbench.scenes.undistort import Intrinsics, undistort_image, undistorted


def write_scene(
    work: Work,
    photographs: Sequence[Prepared],
    holds_split: bool,
    advance: Callable[[int], None],
    offset: Offset = NO_OFFSET,
) -> dict[str, Intrinsics]:
    """Write the scene into `work.scene` from the model in `work.model`. Returns each view's camera with distortion.

    Poses that were known stay as they were, but for rounding. holds_split: the split is written, in transforms.json,
    which readers take before the model. advance: called with the number of photographs done.
    offset: added to all positions.
    """
    model = read_model(work.model)
    by_file = {photograph.file_name: photograph for photograph in photographs}
    views = [by_file[name] for name in model.names]
    # Linear light stays light, so that a dataset of the scene can blur what is brighter than white.
    names = [f"{view.name}.png" if view.light is None else f"{view.name}.exr" for view in views]
    cameras = []
    for index, (view, lens, pose) in enumerate(zip(views, model.intrinsics, model.world_to_camera, strict=True)):
        cameras.append(undistorted(lens).camera(pose))
        path = work.scene / "images" / names[index]
        if not path.is_file() and view.light is not None:
            write_exr(path, undistort_image(read_exr(view.light), lens, light=True), half=True)
        elif not path.is_file():
            image = read_image(work.photographs / view.file_name)
            write_png(path, undistort_image(image, lens))
        if view.mask is not None and not (mask := work.scene / "masks" / f"{names[index]}.png").is_file():
            write_mask(mask, undistort_mask(read_mask(view.mask), lens))
        advance(index + 1)
    points = None if model.points is None else in_front(model.points, cameras)
    export.write_colmap(work.scene, names, cameras, points, offset)
    if holds_split:
        export.write_transforms(
            work.scene / "transforms.json",
            [f"images/{name}" for name in names],
            cameras,
            splits=[view.split or "train" for view in views],
            offset=offset,
            extra=[
                {} if view.mask is None else {"mask_path": f"masks/{name}.png"}
                for view, name in zip(views, names, strict=True)
            ],
        )
    if exif := {view.name: view.exif for view in views if view.exif is not None}:
        write_exif(work.scene, exif)
    return {view.name: lens for view, lens in zip(views, model.intrinsics, strict=True)}


def in_front(points: PointCloud, cameras: Sequence[Camera]) -> PointCloud:
    """Tracks without views that the point lies behind, which no lens can have seen."""
    if points.views is None:
        return points
    before = np.stack([camera.project(points.xyz)[1] > 0 for camera in cameras])
    return replace(points, views=tuple(track[before[track, index]] for index, track in enumerate(points.views)))
