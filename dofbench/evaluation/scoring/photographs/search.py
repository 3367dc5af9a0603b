"""The search for the focus of least error on the fitted half of a photograph: a grid, then Brent's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dofbench.core.lens import DisparityRange, PhysicalLens

BEYOND = 0.25  # share of the disparity range by which foci may lie outside of it
AT_BOUND = 0.02  # of the disparity range: a focus as near to a bound counts as at the bound


@dataclass(frozen=True)
class Effort:
    """Size of a search. focuses: of the grid. coarse: further renderings at the reduced size. fine: at the full size,
    besides the first."""

    focuses: int
    coarse: int
    fine: int


THOROUGH = Effort(focuses=11, coarse=4, fine=5)
QUICK = Effort(focuses=7, coarse=2, fine=0)


@dataclass(frozen=True)
class Allowed:
    """The lenses that are searched for a view: the learned aperture, and foci in the disparity range, extended by a
    quarter of it at both ends.

    aperture: pixels * scene unit, at `width`. disparities: 1 / scene unit. Foci are in normalised disparity.
    """

    aperture: float
    disparities: DisparityRange
    width: int

    def lens(self, focus: float) -> PhysicalLens:
        """The lens of a focus."""
        return PhysicalLens(self.aperture, self.disparities.q_min + focus * self.disparities.extent, self.width)

    @staticmethod
    def at_bound(focus: float) -> bool:
        """Whether a focus is at a bound."""
        return not -BEYOND + AT_BOUND < focus < 1 + BEYOND - AT_BOUND


@dataclass(frozen=True, eq=False)
class Found:
    """The best focus of a search, its cost and image. renders: number of renderings."""

    focus: float
    cost: float
    image: np.ndarray
    renders: int


Render = Callable[[float], np.ndarray]  # the image by a focus
Cost = Callable[[np.ndarray], float]  # error of an image


def best_of_grid(render: Render, cost: Cost, focuses: int) -> tuple[Found, float]:
    """The best of evenly spaced foci, and their distance."""
    grid = np.linspace(-BEYOND, 1 + BEYOND, focuses)
    best = min((found_at(render, cost, float(focus)) for focus in grid), key=lambda found: found.cost)
    return replace(best, renders=focuses), float(grid[1] - grid[0])


def found_at(render: Render, cost: Cost, focus: float) -> Found:
    """A focus with its cost and image, by one rendering."""
    image = render(focus)
    return Found(focus, cost(image), image, 1)


def refined(render: Render, cost: Cost, start: Found, reach: float, most: int) -> Found:
    """Brent's method within `reach` of `start`, with at most `most` further renderings."""
    from scipy.optimize import minimize_scalar

    best, renders = start, start.renders

    def value(focus: float) -> float:
        nonlocal best, renders
        renders += 1
        found = found_at(render, cost, float(focus))
        best = min(best, found, key=lambda one: one.cost)
        return found.cost

    if most > 0:
        bounds = max(start.focus - reach, -BEYOND), min(start.focus + reach, 1 + BEYOND)
        minimize_scalar(value, bounds=bounds, method="bounded", options={"maxiter": most, "xatol": 1e-4})
    return replace(best, renders=renders)
