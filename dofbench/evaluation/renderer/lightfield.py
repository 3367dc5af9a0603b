"""Real defocus: views of a light field, shifted and summed over a round aperture.

A point with disparity d, in pixels per step between views, is at x + d u in the view u steps from the centre. Shifted
back by f u and averaged over |u| <= rho, points with d = f stay sharp and others spread over a disc of radius
rho |d - f|: an image through a lens as wide as the grid, with correct occlusion (Ng et al., Light Field Photography
with a Hand-held Plenoptic Camera, 2005). The renderer gets the centre view and a disparity map by a plane sweep.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file
from dofbench.core.images import read_image
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.optics.tone import decode, encode

GRID = "grid.json"
_SWEEP_STEP = 0.02  # pixels per view step between two planes of the sweep
_SWEEP_MARGIN = 0.15  # pixels per view step beyond the range of disparities in grid.json
_GUIDE_RADIUS, _GUIDE_EPSILON = 5, 1e-4
_NEIGHBOURHOOD = 4  # steps around the best one that aren't compared with it
_CLEAR_MARGIN = 0.01  # encoded grey: a disparity that is better by this margin gets full weight
# The smoother reaches 3 pixels where the weight is 1, and 300 where it is least. Edge: grey levels of 255.
_SMOOTHNESS, _EDGE = 10.0, 6.0
_FOCUS_PERCENTILES = (5.0, 50.0, 95.0)


@dataclass(frozen=True, eq=False)
class LightField:
    """Views on a regular grid.

    views: (H, W, 3) float32 encoded by (row, column) step from the centre. disparities: least and largest, pixels per
    step, from grid.json.
    """

    name: str
    views: dict[tuple[int, int], np.ndarray]
    disparities: tuple[float, float]

    @property
    def centre(self) -> np.ndarray:
        """The centre view."""
        return self.views[0, 0]

    @property
    def steps(self) -> int:
        """Number of view steps from the grid's centre to its border."""
        return min(max(row for row, _ in self.views), max(column for _, column in self.views))


def read_lightfield(folder: Path) -> LightField:
    """Read `views/RR_CC.*` and grid.json. Raises InputError for missing or inconsistent files."""
    path = folder / GRID
    if not path.is_file():
        raise InputError(folder, f"no {GRID}", "a light field: grid.json and views/RR_CC images")
    grid = read_json(path)
    try:
        middle = tuple(int(number) for number in grid["centre"].split("_"))
        measured = grid["disparity_px_per_view_step"].items()
        ends = [value for key, values in measured if key.startswith(("horizontal", "vertical")) for value in values]
        disparities = float(min(ends)), float(max(ends))
    except (KeyError, TypeError, ValueError, AttributeError):
        expected = '"centre": "RR_CC" and "disparity_px_per_view_step"'
        raise InputError(path, "no centre or no disparities", expected) from None
    views = {}
    for file in sorted((folder / "views").glob("*")):
        match = re.fullmatch(r"(\d+)_(\d+)", file.stem)
        if match:
            views[int(match[1]) - middle[0], int(match[2]) - middle[1]] = read_image(file)
    if (0, 0) not in views:
        raise InputError(folder / "views", f"no view {grid['centre']}", "the centre that grid.json names")
    sizes = {view.shape for view in views.values()}
    if len(sizes) > 1:
        raise InputError(folder / "views", f"images of {len(sizes)} sizes", "one size")
    steps = min(max(abs(row) for row, _ in views), max(abs(column) for _, column in views))
    around = range(-steps, steps + 1)
    if steps < 1 or not set(product(around, around)) <= set(views):
        raise InputError(folder / "views", f"{len(views)} views with gaps", "a full grid around the centre")
    return LightField(folder.name, views, disparities)


def lightfield_cases(folder: Path) -> list[Case]:
    """Images at apertures up to the whole grid, focused far, in the middle and near."""
    field = read_lightfield(folder)
    depth = cache(partial(_depth, field))
    content = [sha256_file(folder / GRID)]
    content += [sha256_file(file) for file in sorted((folder / "views").glob("*")) if file.is_file()]
    size = field.centre[..., 0].size / 1e6
    return [
        Case(
            "light field", field.name, float(rho), focus, content, size, partial(_photograph, field, depth, rho, focus)
        )
        for rho, focus in product(range(2, field.steps + 1), _FOCUS_PERCENTILES)
    ]


def _depth(field: LightField) -> tuple[np.ndarray, int]:
    """The centre view's disparity, pixels per step, and +1 if a larger one is nearer, else -1."""
    disparity = sweep(field)
    return disparity, _nearer_sign(field, disparity)


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


def sweep(field: LightField) -> np.ndarray:
    """(H, W) float64 disparity of the centre view, pixels per step.

    For each candidate, all views are shifted onto the centre view. Their difference is averaged over the best half of
    the views (left, right, upper or lower; next to an edge only one side sees the point) and smoothed along edges
    (Rhemann et al., Fast Cost-Volume Filtering, 2011). The best disparity is refined by a parabola. Where it isn't
    clearly better than distant ones, it is interpolated up to the next edge (fast global smoother, Min et al., 2014,
    weighted by the squared margin).
    """
    import cv2

    low, high = field.disparities[0] - _SWEEP_MARGIN, field.disparities[1] + _SWEEP_MARGIN
    candidates = np.arange(low, high + _SWEEP_STEP, _SWEEP_STEP)
    centre = field.centre
    # Every second view suffices.
    chosen = [place for place in field.views if place != (0, 0) and (place[0] + place[1]) % 2 == 0]
    sides = [[place for place in chosen if sign * place[axis] >= 0] for axis in (0, 1) for sign in (1, -1)]
    costs = []
    for candidate in candidates:
        difference = {
            place: np.minimum(np.abs(_shifted(field.views[place], place, candidate) - centre).mean(axis=2), 0.1)
            for place in chosen
        }
        cost = np.min([np.mean([difference[place] for place in side], axis=0) for side in sides], axis=0)
        costs.append(cv2.ximgproc.guidedFilter(centre, cost.astype(np.float32), _GUIDE_RADIUS, _GUIDE_EPSILON))
    volume = np.stack(costs)
    best = np.clip(volume.argmin(axis=0), 1, len(candidates) - 2)
    before, here, after = (np.take_along_axis(volume, (best + k)[None], 0)[0] for k in (-1, 0, 1))
    curvature = before - 2 * here + after
    offset = np.where(curvature > 1e-9, 0.5 * (before - after) / np.maximum(curvature, 1e-9), 0.0)
    disparity = candidates[best] + _SWEEP_STEP * np.clip(offset, -0.5, 0.5)
    far_from_best = np.abs(np.arange(len(candidates))[:, None, None] - best) > _NEIGHBOURHOOD
    margin = np.where(far_from_best, volume, np.inf).min(axis=0) - here
    weight = np.clip(margin / _CLEAR_MARGIN, 0.01, 1.0).astype(np.float32) ** 2
    guide = np.clip(centre * 255 + 0.5, 0, 255).astype(np.uint8)
    smooth = cv2.ximgproc.createFastGlobalSmootherFilter(guide, _SMOOTHNESS, _EDGE)
    return (smooth.filter((weight * disparity).astype(np.float32)) / smooth.filter(weight)).astype(np.float64)


def _aperture(rho: int) -> list[tuple[int, int]]:
    """The steps (row, column) within a radius of rho, row by row."""
    around = range(-rho, rho + 1)
    return [(row, column) for row, column in product(around, around) if row * row + column * column <= rho * rho]


def _added(field: LightField, aperture: list[tuple[int, int]], focus: float) -> np.ndarray:
    """Mean of the views, shifted to `focus`, in linear light."""
    total = np.zeros(field.centre.shape)
    for place in aperture:
        total += decode(np.clip(_shifted(field.views[place], place, focus), 0, 1).astype(np.float64))
    return total / len(aperture)


def _shifted(view: np.ndarray, place: tuple[int, int], disparity: float) -> np.ndarray:
    """The view of `place`, sampled at x + disparity * place for every x of the centre view."""
    import cv2

    # OpenCV's warping rounds positions to 1/32 pixel, which is coarser than a step of the sweep.
    by_row, by_column = (_lanczos(disparity * step) for step in place)
    return cv2.sepFilter2D(view, -1, by_column, by_row, borderType=cv2.BORDER_REPLICATE)


def _lanczos(shift: float) -> np.ndarray:
    """Weights of the pixels around x for the value at x + shift: Lanczos, 3 lobes."""
    reach = math.ceil(abs(shift)) + 3
    distance = np.arange(-reach, reach + 1) - shift
    weights = np.where(np.abs(distance) < 3, np.sinc(distance) * np.sinc(distance / 3), 0.0)
    return weights / weights.sum()


def _nearer_sign(field: LightField, disparity: np.ndarray) -> int:
    """+1 if a larger disparity is nearer, else -1, by occlusion.

    Of two points of the centre view on one pixel of an outer view, the one with the pixel's colour is nearer.
    """
    height, width = disparity.shape
    rows, columns = np.mgrid[:height, :width]
    votes = 0
    for place in ((0, field.steps), (0, -field.steps), (field.steps, 0), (-field.steps, 0)):
        y = np.rint(rows + disparity * place[0]).astype(int)
        x = np.rint(columns + disparity * place[1]).astype(int)
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        target = (y * width + x)[inside]
        source = np.flatnonzero(inside.reshape(-1))
        by_disparity = np.argsort(disparity.reshape(-1)[source], kind="stable")
        least, most = np.full(height * width, -1), np.full(height * width, -1)
        most[target[by_disparity]] = source[by_disparity]
        least[target[by_disparity[::-1]]] = source[by_disparity[::-1]]
        flat = disparity.reshape(-1)
        contested = np.flatnonzero((least >= 0) & (flat[most] - flat[least] > 0.2))
        seen, colours = field.views[place].reshape(-1, 3)[contested], field.centre.reshape(-1, 3)
        by_least = np.abs(colours[least[contested]] - seen).sum(axis=1)
        by_most = np.abs(colours[most[contested]] - seen).sum(axis=1)
        votes += int((by_most < by_least).sum()) - int((by_least < by_most).sum())
    return 1 if votes >= 0 else -1
