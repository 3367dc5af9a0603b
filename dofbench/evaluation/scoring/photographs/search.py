"""The search for the focus of least error on the fitted half of a photograph: a grid, then Brent's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dofbench.core.lens import DisparityRange, PhysicalLens

BEYOND = 0.25  # share of the disparity range by which foci may lie outside of it
AT_BOUND = 0.02  # of the disparity range: a focus as near to a bound counts as at the bound


@dataclass(frozen=True)
class Effort:
    """Size of a search. focuses: of the grid. coarse, fine: further renderings at the reduced and the full size."""

    focuses: int
    coarse: int
    fine: int


THOROUGH = Effort(focuses=11, coarse=5, fine=6)
QUICK = Effort(focuses=7, coarse=3, fine=1)


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
    images = [(float(focus), render(float(focus))) for focus in grid]
    focus, image = min(images, key=lambda pair: cost(pair[1]))
    return Found(focus, cost(image), image, focuses), float(grid[1] - grid[0])


def refined(render: Render, cost: Cost, start: float, reach: float, most: int) -> Found:
    """Brent's method within `reach` of `start`, with at most `most` renderings, the first one at `start`."""
    from scipy.optimize import minimize_scalar

    image = render(start)
    best = Found(start, cost(image), image, 1)
    asked = 1

    def value(focus: float) -> float:
        nonlocal best, asked
        asked += 1
        image = render(float(focus))
        found = cost(image)
        if found < best.cost:
            best = Found(float(focus), found, image, 0)
        return found

    if most > 1:
        bounds = max(start - reach, -BEYOND), min(start + reach, 1 + BEYOND)
        minimize_scalar(value, bounds=bounds, method="bounded", options={"maxiter": most - 1, "xatol": 1e-4})
    return Found(best.focus, best.cost, best.image, asked)
