"""A light field's folder: `views/RR_CC` images on a regular grid, and grid.json."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file
from dofbench.core.images import image_size, read_image, resize

LIGHT_FIELD = "lightfield"  # the layout of a scene of its views
GRID = "grid.json"
_VIEWS, _POSITIONS, _DISPARITIES = "views", "position_vu_mm", "disparity_px_per_view_step"
# A view's place on the grid: (row, column) steps from the centre view.
Place = tuple[int, int]
STEP = "grid step"  # unit of positions that grid.json doesn't state


@dataclass(frozen=True, eq=False)
class Grid:
    """The views of a light field; they are read when asked for.

    files: by place. size: (width, height), pixels. positions: by place, (2,) float64, of the camera in its plane,
    relative to the centre view's; in `unit`. Without positions in grid.json, these are the places themselves.
    disparities: least and largest, pixels per step, where grid.json states them.
    """

    root: Path
    files: Mapping[Place, Path]
    size: tuple[int, int]
    positions: Mapping[Place, np.ndarray]
    unit: str
    disparities: tuple[float, float] | None

    @property
    def steps(self) -> int:
        """Steps from the centre to the nearest border."""
        return min(max(abs(row) for row, _ in self.files), max(abs(column) for _, column in self.files))

    @property
    def step(self) -> float:
        """Mean distance of neighbouring views, in `unit`: the square root of a grid cell's area."""
        places = np.array(list(self.files), dtype=np.float64)
        fit, *_ = np.linalg.lstsq(places, np.array(list(self.positions.values())), rcond=None)
        return float(abs(np.linalg.det(fit)) ** 0.5)

    def name(self, place: Place) -> str:
        """The view's name, RR_CC."""
        return self.files[place].stem

    def read(self, place: Place, width: int | None = None) -> np.ndarray:
        """The view, (H, W, 3) float32, encoded; shrunk to `width` pixels by area averaging. Raises InputError for an
        image that can't be read."""
        image = read_image(self.files[place])
        return image if width is None else resize(image, width, self.height_at(width))

    def height_at(self, width: int) -> int:
        """Height in pixels of a view shrunk to `width` pixels."""
        return max(1, int(self.size[1] * width / self.size[0] + 0.5))

    def checksums(self) -> list[str]:
        """sha256 of grid.json, then of every file in views/ by name."""
        files = [self.root / GRID, *(file for file in sorted((self.root / _VIEWS).glob("*")) if file.is_file())]
        return [sha256_file(file) for file in files]


def is_grid(folder: Path) -> bool:
    """Whether the folder is a light field's."""
    return (folder / GRID).is_file() and (folder / _VIEWS).is_dir()


def read_grid(folder: Path) -> Grid:
    """Read grid.json and the headers of the images. Raises InputError for missing or inconsistent files."""
    path = folder / GRID
    if not path.is_file():
        raise InputError(folder, f"no {GRID}", f"a light field: {GRID} and {_VIEWS}/RR_CC images")
    stated = read_json(path)
    centre = _centre(path, stated)
    files: dict[Place, Path] = {}
    for file in sorted((folder / _VIEWS).glob("*")):
        match = re.fullmatch(r"(\d+)_(\d+)", file.stem)
        if match:
            files[int(match[1]) - centre[0], int(match[2]) - centre[1]] = file
    if (0, 0) not in files:
        raise InputError(folder / _VIEWS, f"no view {stated['centre']}", f"the centre that {GRID} names")
    steps = min(max(abs(row) for row, _ in files), max(abs(column) for _, column in files))
    around = range(-steps, steps + 1)
    if steps < 1 or not set(product(around, around)) <= set(files):
        raise InputError(folder / _VIEWS, f"{len(files)} views with gaps", "a full grid around the centre")
    sizes = {image_size(file) for file in files.values()}
    if len(sizes) > 1:
        raise InputError(folder / _VIEWS, f"images of {len(sizes)} sizes", "one size")
    positions = _positions(path, stated, files)
    return Grid(
        root=folder,
        files=files,
        size=sizes.pop(),
        positions=positions or {place: np.array(place, dtype=np.float64) for place in files},
        unit="mm" if positions else STEP,
        disparities=_disparities(path, stated),
    )


def _centre(path: Path, stated: Any) -> Place:
    try:
        row, column = (int(number) for number in stated["centre"].split("_"))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(path, "no centre", '"centre": "RR_CC", the name of a view') from None
    return row, column


def _positions(path: Path, stated: Any, files: Mapping[Place, Path]) -> dict[Place, np.ndarray] | None:
    """By place, relative to the centre view's; None where grid.json has none."""
    if _POSITIONS not in stated:
        return None
    found: dict[Place, np.ndarray] = {}
    for place, file in files.items():
        try:
            position = np.array(stated[_POSITIONS][file.stem], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            position = np.empty(0)
        if position.shape != (2,) or not np.isfinite(position).all():
            raise InputError(path, f"no position of view {file.stem}", f'two numbers in "{_POSITIONS}" for every view')
        found[place] = position
    middle = found[0, 0]
    relative = {place: position - middle for place, position in found.items()}
    if np.linalg.matrix_rank(np.array(list(relative.values())), tol=1e-9) < 2:
        raise InputError(path, "positions on a line", "positions in a plane")
    return relative


def _disparities(path: Path, stated: Any) -> tuple[float, float] | None:
    if _DISPARITIES not in stated:
        return None
    try:
        measured = stated[_DISPARITIES].items()
        ends = [value for key, values in measured if key.startswith(("horizontal", "vertical")) for value in values]
        return float(min(ends)), float(max(ends))
    except (TypeError, ValueError, AttributeError):
        expected = f'numbers for "horizontal" and "vertical" in "{_DISPARITIES}"'
        raise InputError(path, "no disparities", expected) from None
