"""What another program has left: pictures, depth, learned lenses, figures of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, FiniteFloat, PositiveInt, TypeAdapter, ValidationError

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.errors import Ended, InputError, Status
from dofbench.core.files import read_json
from dofbench.core.images import read_image
from dofbench.core.lens import PhysicalLens
from dofbench.core.readable import read_array

LENSES_FILE, FIGURES_FILE = "lenses.json", "figures.json"


class _Lens(BaseModel):
    model_config = ConfigDict(extra="forbid")
    aperture: FiniteFloat
    focus_disparity: FiniteFloat
    width: PositiveInt


def read_picture(folder: Path, file: str, camera: Camera) -> Rendering:
    """The picture `file` below `folder`, and the depth beside it, NAME.npy; NaN where the program makes none.

    Raises `Ended`, as crashed, for a file that is missing or can't be read, or has another size than the camera's.
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
    """The lens of every training photograph, from lenses.json; None without the file.

    Raises `Ended`, as crashed, for another content, and where a photograph is missing.
    """
    path = folder / LENSES_FILE
    if not path.is_file():
        return None
    try:
        found = TypeAdapter(dict[str, _Lens]).validate_python(read_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        raise _wrong(path, f"{'.'.join(map(str, first['loc']))}: {first['msg']}", "a lens by photograph") from None
    except InputError as error:
        raise Ended(Status.CRASHED, str(error)) from None
    if missing := [name for name in names if name not in found]:
        raise _wrong(path, f"no lens of {missing[0]} ({len(missing)} are missing)", "one of every photograph")
    return {name: PhysicalLens(**found[name].model_dump()) for name in names}


def read_figures(folder: Path) -> dict[str, float]:
    """Numbers that the program tells of its training, from figures.json, such as `steps` and `gaussians`; empty without
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
