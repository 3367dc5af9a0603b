"""Files exchanged with another program: the training set and the wanted views, its images, depth, lenses, figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat, PositiveInt, TypeAdapter, ValidationError

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering, TrainingSet
from dofbench.core.errors import Ended, InputError, Status
from dofbench.core.files import read_json
from dofbench.core.image_files.exif import write_exif
from dofbench.core.images import read_image, write_png
from dofbench.core.lens import PhysicalLens
from dofbench.core.masks import write_mask
from dofbench.core.readable import read_array
from dofbench.scenes.export import depth_bounds, view_bounds, write_colmap, write_poses_bounds, write_transforms
from dofbench.scenes.visibility import visible


@dataclass(frozen=True, eq=False)
class Wanted:
    """An image that the program has to render: its file, relative to the folder of images, the camera, and the lens;
    None for all in focus."""

    file: str
    camera: Camera
    lens: PhysicalLens | None


def write_training_set(folder: Path, training_set: TrainingSet) -> None:
    """Write the training views, and nothing of a test view.

    images/NAME.png, rounded to 8 bits as in a dataset, masked pixels replaced by their nearest valid ones;
    masks/NAME.png, 0 where masked, named by transforms.json as mask_path; cameras and points in COLMAP's layout
    (sparse/0), LLFF's (poses_bounds.npy, where points give the bounds; rows in the order of the sorted files) and
    Nerfstudio's (transforms.json); exif.json where there is EXIF.
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
        bounds = depth_bounds(view_bounds(visible(points, camera, index).depth) for index, camera in enumerate(cameras))
        if bounds is not None:
            write_poses_bounds(folder / "poses_bounds.npy", cameras, bounds)
    if exif := {view.name: view.exif for view in views if view.exif is not None}:
        write_exif(folder, exif)


def write_wanted(folder: Path, wanted: Sequence[Wanted]) -> None:
    """Write the views to be rendered: transforms.json, whose frames have the image's file as `file_path` and the
    `lens`, if any; and sparse/0 with the same files and no points."""
    files, cameras = [one.file for one in wanted], [one.camera for one in wanted]
    extra = [{} if one.lens is None else {"lens": vars(one.lens)} for one in wanted]
    folder.mkdir(parents=True, exist_ok=True)
    write_transforms(folder / "transforms.json", files, cameras, extra=extra)
    write_colmap(folder, files, cameras, None)


LENSES_FILE, FIGURES_FILE = "lenses.json", "figures.json"


class _Lens(BaseModel):
    model_config = ConfigDict(extra="forbid")
    aperture: FiniteFloat
    focus_disparity: FiniteFloat
    width: PositiveInt


def read_picture(folder: Path, file: str, camera: Camera) -> Rendering:
    """Read the image `file` below `folder`, and the depth next to it, NAME.npy; NaN without.

    Raises `Ended`, as crashed, for a file that is missing, unreadable, or of another size than the camera's.
    """
    path = folder / file
    size = camera.height, camera.width
    try:
        image = read_image(path)
    except InputError as error:
        raise Ended(Status.CRASHED, str(error)) from None
    if image.shape != (*size, 3):
        raise _wrong(path, f"{image.shape[1]} x {image.shape[0]} pixels", f"{camera.width} x {camera.height}")
    return Rendering(image, _read_depth(path.with_suffix(".npy"), size))


def _read_depth(path: Path, size: tuple[int, int]) -> np.ndarray:
    if not path.is_file():
        return np.full(size, np.nan, np.float32)
    try:
        depth = read_array(path, "the depth of each pixel, scene units, 0 where empty")
    except InputError as error:
        raise Ended(Status.CRASHED, str(error)) from None
    if depth.shape != size or depth.dtype.kind not in "fiu":
        raise _wrong(path, f"{depth.dtype} of shape {depth.shape}", f"numbers of shape {size}")
    return depth.astype(np.float32)


def read_lenses(folder: Path, names: Sequence[str]) -> dict[str, PhysicalLens] | None:
    """Read the lens of every training view from lenses.json; None without the file.

    Raises `Ended`, as crashed, for another content, and where a view is missing.
    """
    path = folder / LENSES_FILE
    if not path.is_file():
        return None
    try:
        found = TypeAdapter(dict[str, _Lens]).validate_python(read_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise _wrong(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}", "a lens by view") from None
    except InputError as error:
        raise Ended(Status.CRASHED, str(error)) from None
    if missing := [name for name in names if name not in found]:
        raise _wrong(path, f"no lens of {missing[0]} ({len(missing)} are missing)", "one of every view")
    return {name: PhysicalLens(**found[name].model_dump()) for name in names}


def read_figures(folder: Path) -> dict[str, float]:
    """Read the program's numbers about its training, such as `steps` and `gaussians`, from figures.json; empty without
    the file. Raises `Ended`, as crashed, for another content."""
    path = folder / FIGURES_FILE
    if not path.is_file():
        return {}
    try:
        found = TypeAdapter(dict[str, float]).validate_python(read_json(path))
    except (ValidationError, InputError) as error:
        raise _wrong(path, " ".join(str(error).split()), "numbers by name") from None
    if bad := [name for name, value in found.items() if not math.isfinite(value)]:
        raise _wrong(path, f"{bad[0]} = {found[bad[0]]}", "finite numbers")
    return found


def _wrong(path: Path, found: str, expected: str) -> Ended:
    return Ended(Status.CRASHED, f"{path}: found {found}, expected {expected}")
