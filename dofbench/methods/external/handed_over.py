"""What another program is given: the training photographs, and later the views to be rendered, in common layouts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet
from dofbench.core.image_files.exif import write_exif
from dofbench.core.images import write_png
from dofbench.core.lens import PhysicalLens
from dofbench.core.masks import write_mask
from dofbench.scenes.export import depth_bounds, write_colmap, write_poses_bounds, write_transforms
from dofbench.scenes.visibility import visible


@dataclass(frozen=True, eq=False)
class Wanted:
    """A picture that the program has to make: its file, relative to the folder of pictures, the camera, and the lens;
    None for all in focus."""

    file: str
    camera: Camera
    lens: PhysicalLens | None


def write_training_set(folder: Path, training_set: TrainingSet) -> None:
    """Write the photographs to images/NAME.png, and cameras and points in COLMAP's layout (sparse/0), LLFF's
    (poses_bounds.npy, where points give the bounds; rows in the order of the sorted files) and Nerfstudio's
    (transforms.json); exif.json where there is EXIF. Masks are written to masks/NAME.png, 0 where masked, and named by
    transforms.json as mask_path; masked pixels of the photographs are replaced by their nearest valid ones.

    Photographs are rounded to 8 bits, as those of a dataset are. Nothing of a test view is written.
    """
    views = sorted(training_set.views, key=lambda view: f"{view.name}.png")
    order = [training_set.views.index(view) for view in views]
    points = None if training_set.points is None else training_set.points.seen_by(order)
    files, cameras = [f"{view.name}.png" for view in views], [view.camera for view in views]
    for file, view in zip(files, views, strict=True):
        write_png(folder / "images" / file, view.image)
    write_colmap(folder, files, cameras, points)
    named: list[dict[str, str]] = [{} for _ in views]
    for entry, file, view in zip(named, files, views, strict=True):
        if view.mask is not None:
            write_mask(folder / "masks" / file, view.mask)
            entry["mask_path"] = f"masks/{file}"
    write_transforms(folder / "transforms.json", [f"images/{file}" for file in files], cameras, extra=named)
    if points is not None and len(points):
        bounds = depth_bounds([visible(points, camera, index).depth for index, camera in enumerate(cameras)])
        if bounds is not None:
            write_poses_bounds(folder / "poses_bounds.npy", cameras, bounds)
    if exif := {view.name: view.exif for view in views if view.exif is not None}:
        write_exif(folder, exif)


def write_wanted(folder: Path, wanted: Sequence[Wanted]) -> None:
    """Write the views to be rendered: transforms.json, whose frames have the picture's file as `file_path` and, where
    there is one, the `lens`; and sparse/0 with the same files and no points."""
    files, cameras = [one.file for one in wanted], [one.camera for one in wanted]
    extra = [{} if one.lens is None else {"lens": lens_as_data(one.lens)} for one in wanted]
    folder.mkdir(parents=True, exist_ok=True)
    write_transforms(folder / "transforms.json", files, cameras, extra=extra)
    write_colmap(folder, files, cameras, None)


def lens_as_data(lens: PhysicalLens) -> dict[str, Any]:
    """The lens as JSON, with the units of `PhysicalLens`."""
    return {"aperture": lens.aperture, "focus_disparity": lens.focus_disparity, "width": lens.width}
