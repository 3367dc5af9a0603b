"""Real defocus: views of a light field, shifted and averaged over a round aperture (`scenes/light_field/average.py`).

The renderer gets the centre view and a disparity map by a plane sweep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.optics.tone import encode
from dofbench.scenes.light_field.average import averaged
from dofbench.scenes.light_field.grid import GRID, Grid, Place, read_grid
from dofbench.scenes.light_field.sweep import MARGIN, Neighbour, sweep

_SWEEP_STEP = 0.02  # pixels per view step between two planes of the sweep
_FOCUS_PERCENTILES = (5.0, 50.0, 95.0)
_CONTESTED = 0.2  # pixels per view step between two points that are compared


@dataclass(frozen=True, eq=False)
class LightField:
    """Views on a regular grid, read.

    views: (H, W, 3) float32 encoded by (row, column) step from the centre. disparities: least and largest, pixels per
    step, from grid.json.
    """

    grid: Grid
    views: dict[Place, np.ndarray]
    disparities: tuple[float, float]

    @property
    def centre(self) -> np.ndarray:
        """The centre view."""
        return self.views[0, 0]

    def neighbours(self, places: Iterable[Place]) -> list[Neighbour]:
        """Views at these places, seen from the centre view; a point of disparity 1 moves by a pixel a step."""
        return [Neighbour(self.views[place], place, place) for place in places]


def read_lightfield(folder: Path) -> LightField:
    """Read the grid and all views. Raises InputError for missing or inconsistent files."""
    grid = read_grid(folder)
    if grid.disparities is None:
        raise InputError(folder / GRID, "no disparities", '"disparity_px_per_view_step"')
    return LightField(grid, {place: grid.read(place) for place in grid.files}, grid.disparities)


def lightfield_cases(folder: Path) -> list[Case]:
    """Images at apertures up to the whole grid, focused far, in the middle and near."""
    field = read_lightfield(folder)
    name, depth = field.grid.root.name, cache(partial(_depth, field))
    content = field.grid.checksums()
    size = field.centre[..., 0].size / 1e6
    return [
        Case("light field", name, float(rho), focus, content, size, partial(_photograph, field, depth, rho, focus))
        for rho, focus in product(range(2, field.grid.steps + 1), _FOCUS_PERCENTILES)
    ]


def _depth(field: LightField) -> tuple[np.ndarray, int]:
    """The centre view's disparity, pixels per step, and +1 if a larger one is nearer, else -1."""
    disparity = swept(field)
    steps = field.grid.steps
    outer = field.neighbours([(0, steps), (0, -steps), (steps, 0), (-steps, 0)])
    return disparity, _nearer_sign(field.centre, disparity, outer, _CONTESTED)


def _photograph(field: LightField, depth: Callable[[], tuple[np.ndarray, int]], rho: int, percentile: float) -> Truth:
    """The mean of the views within `rho` steps, focused at a percentile of the disparity."""
    disparity, nearer = depth()
    focus = float(np.percentile(disparity, percentile))
    aperture = _aperture(rho)
    radius = math.sqrt(len(aperture) / math.pi)  # of the disc with the views' area, one square step each
    whole, half = _added(field, aperture, focus), _added(field, aperture[::2], focus)
    error = float(np.mean((encode(whole) - encode(half)) ** 2))
    return Truth(
        sharp=field.centre,
        signed_radius=(nearer * radius * (disparity - focus)).astype(np.float32),
        photograph=encode(whole).astype(np.float32),
        border=math.ceil(rho * max(map(abs, field.disparities))) + 4,
        own_error_db=-10 * math.log10(error),
    )


def swept(field: LightField) -> np.ndarray:
    """(H, W) float64 disparity of the centre view, pixels per step, by a plane sweep; every second view suffices."""
    low, high = field.disparities[0] - MARGIN, field.disparities[1] + MARGIN
    chosen = [place for place in field.views if place != (0, 0) and (place[0] + place[1]) % 2 == 0]
    return sweep(field.centre, field.neighbours(chosen), low, high, _SWEEP_STEP).disparity


def _aperture(rho: int) -> list[Place]:
    """The steps (row, column) within a radius of rho, row by row."""
    around = range(-rho, rho + 1)
    return [(row, column) for row, column in product(around, around) if row * row + column * column <= rho * rho]


def _added(field: LightField, aperture: list[Place], focus: float) -> np.ndarray:
    """Mean of the views, shifted to `focus`, in linear light."""
    return averaged((field.views[place], (focus * place[0], focus * place[1]), 1.0) for place in aperture)


def _nearer_sign(view: np.ndarray, disparity: np.ndarray, others: Sequence[Neighbour], apart: float) -> int:
    """+1 if a larger disparity (H, W) is nearer, else -1, by occlusion.

    Of two points of the view on one pixel of another one, the one with the pixel's colour is nearer. others: distant
    views on several sides. apart: by how much the two points' disparities must differ.
    """
    height, width = disparity.shape
    rows, columns = np.mgrid[:height, :width]
    flat, colours = disparity.reshape(-1), view.reshape(-1, 3)
    votes = 0
    for other in others:
        y = np.rint(rows + disparity * other.offset[0]).astype(int)
        x = np.rint(columns + disparity * other.offset[1]).astype(int)
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        target = (y * width + x)[inside]
        source = np.flatnonzero(inside.reshape(-1))
        by_disparity = np.argsort(flat[source], kind="stable")
        least, most = np.full(height * width, -1), np.full(height * width, -1)
        most[target[by_disparity]] = source[by_disparity]
        least[target[by_disparity[::-1]]] = source[by_disparity[::-1]]
        contested = np.flatnonzero((least >= 0) & (flat[most] - flat[least] > apart))
        seen = other.image.reshape(-1, 3)[contested]
        by_least = np.abs(colours[least[contested]] - seen).sum(axis=1)
        by_most = np.abs(colours[most[contested]] - seen).sum(axis=1)
        votes += int((by_most < by_least).sum()) - int((by_least < by_most).sum())
    return 1 if votes >= 0 else -1
