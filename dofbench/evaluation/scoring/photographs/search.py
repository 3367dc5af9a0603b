"""Search for the lens or Gaussian blur of least `cost`, on the fitted half of a photograph: a grid, then
Nelder-Mead."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dofbench.core.lens import COC_FRACTION, DisparityRange, PhysicalLens

Cost = Callable[[np.ndarray], float]  # error of an image

APERTURES = (0.25, 0.5, 1.0, 2.0, 4.0)  # of the grid: CoC radius over the disparity range, in units of A = 1
LEAST_STEP = 0.001  # share of the width, or of the disparity range, below which CoC radii or foci are the same


@dataclass(frozen=True)
class Effort:
    """Size of a search. apertures: number of `APERTURES`, starting with the second if not all. focuses: of the grid.
    coarse, fine: renderings of the simplex at the reduced and the full size. blur: also fit one Gaussian blur."""

    apertures: int
    focuses: int
    coarse: int
    fine: int
    blur: bool = False


THOROUGH = Effort(apertures=5, focuses=5, coarse=12, fine=10, blur=True)
QUICK = Effort(apertures=3, focuses=3, coarse=8, fine=1)


@dataclass(frozen=True)
class Frame:
    """The disparity range (1 / scene unit) and image width (pixels) of signed CoC radii.

    A lens is given by its signed radii at both ends of the range, as shares of the width. Both affect the image equally
    and continuously through zero, whereas a focus F has no effect at a small aperture A.
    """

    disparities: DisparityRange
    width: int

    def lens(self, ends: np.ndarray) -> PhysicalLens:
        """The lens with these signed radii at q_min and q_max; both negated give the same blur."""
        low, high = float(ends[0]), float(ends[1])
        slope = high - low
        least = 1e-6  # slope 0 would have no focus
        if abs(slope) < least:
            slope = math.copysign(least, slope)
        focus = self.disparities.q_min - low / slope * self.disparities.extent
        return PhysicalLens(abs(slope) * self.width / self.disparities.extent, focus, self.width)

    def ends(self, lens: PhysicalLens) -> np.ndarray:
        """(2,) signed radii of a lens, the inverse of `lens`."""
        ends = np.array([self.disparities.q_min, self.disparities.q_max])
        return np.asarray(lens.signed_radius(ends, self.width)) / self.width


def lens_grid(frame: Frame, learned: PhysicalLens | None, effort: Effort) -> list[PhysicalLens]:
    """The grid: a lens without blur, and every aperture with every focus, including those of the `learned` lens."""
    first = 0 if effort.apertures == len(APERTURES) else 1
    disparities, width = frame.disparities, frame.width
    apertures = [COC_FRACTION * a * width / disparities.extent for a in APERTURES[first : first + effort.apertures]]
    focuses = list(np.linspace(disparities.q_min, disparities.q_max, effort.focuses))
    if learned is not None:
        apertures.append(learned.aperture_at(width))
        # A focus far outside the range would blur everything equally.
        ends = disparities.q_min - disparities.extent, disparities.q_max + disparities.extent
        focuses.append(float(np.clip(learned.focus_disparity, *ends)))
    lenses = [PhysicalLens(float(a), float(f), width) for a in apertures for f in focuses if a > 0]
    return [PhysicalLens(0.0, float(focuses[0]), width), *lenses]


@dataclass(frozen=True, eq=False)
class Found:
    """The best point of a search, its cost and image. renders: number of renderings."""

    at: np.ndarray
    cost: float
    image: np.ndarray
    renders: int


def simplex(render: Callable[[np.ndarray], np.ndarray], cost: Cost, start: np.ndarray, most: int, step: float) -> Found:
    """Nelder-Mead from `start` with at most `most` renderings. step: first step along each coordinate."""
    from scipy.optimize import minimize

    best: list[Found] = []

    def value(at: np.ndarray) -> float:
        image = render(at)
        found = cost(image)
        if not best or found < best[0].cost:
            best[:] = [Found(np.array(at), found, image, 0)]
        return found

    corners = np.concatenate([start[None], start + step * np.eye(len(start))])
    asked = 1
    if most < len(corners):
        value(start)
    else:
        options = {"initial_simplex": corners, "maxfev": most, "xatol": LEAST_STEP / 10, "fatol": 0.0}
        asked = minimize(value, start, method="Nelder-Mead", options=options).nfev
    return Found(best[0].at, best[0].cost, best[0].image, asked)


def best_sigma(blurred: Callable[[float], np.ndarray], cost: Cost, largest: float) -> tuple[float, np.ndarray]:
    """(sigma, image) of the Gaussian blur of least cost, 0 to `largest` pixels: a grid, then five bisections."""
    tried: dict[float, float] = {}

    def value(sigma: float) -> float:
        if sigma not in tried:
            tried[sigma] = cost(blurred(sigma))
        return tried[sigma]

    # Geometric, since the visible difference between two blurs is relative to their size.
    grid = [0.0, *(largest * 2.0 ** (-k / 2) for k in range(12, -1, -1))]
    best = min(range(len(grid)), key=lambda index: value(grid[index]))
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    middle = grid[best]
    for _ in range(5):
        left, right = (low + middle) / 2, (middle + high) / 2
        chosen = min((middle, left, right), key=value)
        low, high = (low, middle) if chosen == left else (middle, high) if chosen == right else (left, right)
        middle = chosen
    return middle, blurred(middle)
