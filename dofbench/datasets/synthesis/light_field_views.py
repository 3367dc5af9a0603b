"""Which views of a light field's grid become views of a dataset, and at which size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

from dofbench.core.errors import InputError
from dofbench.core.lens import COC_FRACTION
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes.light_field.average import LOBES
from dofbench.scenes.light_field.grid import Grid, Place
from dofbench.scenes.light_field.rig import Rig
from dofbench.scenes.light_field.window import reach_of

SPACING = 2  # grid steps between neighbouring views, unless asked
CROPPED = "views are cropped by as much as a window shifts them"
_LEAST_STEPS = 2  # from the centre to the border: smaller grids hold no window
_ROUNDED_DOWN = 0.49  # of a step: a window that is wider than a number of steps by this doesn't reach the next one


@dataclass(frozen=True)
class Chosen:
    """places: on the grid, by view name. width: of the grid's views, pixels, of which `margin` are cropped at each
    border."""

    places: Mapping[str, Place]
    width: int
    margin: int


def check_grid(grid: Grid, settings: MakeDataset) -> None:
    """Raise InputError for a grid too small for windows, a spacing too large for it, and a width beyond its views'."""
    if grid.steps < _LEAST_STEPS:
        found = f"{grid.steps} step from the centre to the border"
        raise InputError(grid.root, found, f"{_LEAST_STEPS} or more, as windows are averaged")
    if _spacing(settings) >= grid.steps:
        found = f"{_spacing(settings)}, and {grid.steps} steps from the centre of {grid.root} to its border"
        raise InputError("--spacing", found, "less, so that there is room for windows")
    if settings.width is not None and settings.width > grid.size[0]:
        raise InputError("--width", str(settings.width), f"at most {grid.size[0]}, the width of the views")


def with_defaults(settings: MakeDataset, rig: Rig) -> MakeDataset:
    """The settings with all values that depend on the grid: spacing, points, and apertures, unless asked for: a window
    of half the steps from the centre to the border, and one of half of that."""
    aperture = settings.aperture
    if aperture is None:
        steps = min(0.5 * rig.grid.steps, rig.grid.steps - _spacing(settings) + _ROUNDED_DOWN)
        full = rig.grid.size[0]
        whole = min(1.0, _two_digits(steps * rig.grid.step / _radius(rig, 1.0, full, full)))
        aperture = (round(whole / 2, 3), whole)
    return replace(
        settings,
        photographs="light-field",
        aperture=aperture,
        spacing=_spacing(settings),
        points="shallow" if settings.points == "scene" else settings.points,
    )


def choose_views(rig: Rig, settings: MakeDataset) -> Chosen:
    """Every `spacing`-th view around the centre, as far out as the widest window is inside the grid.

    Raises InputError for a window that leaves room for a single view, and for a width that leaves no border to crop.
    """
    grid, full = rig.grid, rig.grid.size[0]
    values = [settings.values, *([settings.held_out_values] if settings.held_out_values else [])]
    aperture = max(aperture for one in values for aperture in one.aperture)
    margin = 0
    while True:  # the margin only grows, so this ends
        width = full if settings.width is None else settings.width + 2 * margin
        if width > full:
            raise InputError("--width", str(settings.width), f"at most {full - 2 * margin}: {CROPPED}")
        radius = _radius(rig, aperture, width - 2 * margin, width)
        reach = reach_of(radius / grid.step)
        if reach > grid.steps - _spacing(settings):
            widest = (grid.steps - _spacing(settings) + _ROUNDED_DOWN) * grid.step
            found = f"{aperture:g}, a window of {radius / grid.step:.2f} grid steps in radius"
            most = _two_digits(aperture * widest / radius)
            expected = f"at most {most:g}, as the grid has {grid.steps} steps from its centre to its border"
            raise InputError("--aperture", found, expected)
        places = _lattice(grid, reach, _spacing(settings))
        needed = _shift(rig, [focus for one in values for focus in one.focus], places.values(), reach, width)
        if needed <= margin:
            break
        margin = needed
    if min(width, grid.height_at(width)) <= 4 * margin:
        found = f"{width - 2 * margin}, with {margin} pixels to crop at each border"
        raise InputError("--width", found, "a larger one, or a smaller --aperture")
    return Chosen(places, width, margin)


def _spacing(settings: MakeDataset) -> int:
    return settings.spacing or SPACING


def _two_digits(value: float) -> float:
    """The value, rounded down to two decimals."""
    return math.floor(100 * value) / 100


def _radius(rig: Rig, aperture: float, width: int, views_width: int) -> float:
    """Radius of the window of an aperture, in the grid's unit. width: of the images; views_width: of the grid's views,
    uncropped; pixels."""
    far, near = rig.parallax
    return COC_FRACTION * width * aperture / ((near - far) * views_width / rig.grid.size[0])


def _lattice(grid: Grid, reach: int, spacing: int) -> dict[str, Place]:
    """Every `spacing`-th view around the centre that has `reach` steps on all sides, by name."""
    count = (grid.steps - reach) // spacing
    along = [spacing * step for step in range(-count, count + 1)]
    return {grid.name((row, column)): (row, column) for row, column in product(along, along)}


def _shift(rig: Rig, focuses: Sequence[float], places: Iterable[Place], reach: int, width: int) -> int:
    """Pixels by which a window of `reach` steps shifts a view at most, with the reach of the interpolation."""
    far, near = rig.parallax
    parallax = max(abs(far + focus * (near - far)) for focus in focuses)
    away = max(
        abs(by)
        for row, column in places
        for down, right in product((-reach, reach), repeat=2)
        for by in rig.motion((row, column), (row + down, column + right), width)
    )
    return math.ceil(parallax * away) + LOBES
