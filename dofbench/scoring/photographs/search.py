"""The lens, or the one blur, by which a prediction comes nearest to a photograph: a grid, then Nelder and Mead's
simplex.

Everything is decided by `cost`, which sees the half of the photograph that is fitted on and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dofbench.core.lens import COC_FRACTION, DisparityRange, PhysicalLens

Cost = Callable[[np.ndarray], float]  # of an image

# Circles of confusion that the disparities of the view span, in units of the paper's largest (A = 1).
APERTURES = (0.25, 0.5, 1.0, 2.0, 4.0)
# Signed circles below this, as a share of the width, can't be told from none; nor foci this near, as a share of the
# disparities.
LEAST_STEP = 0.001


@dataclass(frozen=True)
class Effort:
    """apertures: how many of `APERTURES`, from the second where not all. focuses: planes of the grid. coarse, fine:
    renderings of the simplex, at the reduced and at the full size. blur: whether to predict by one Gaussian blur too,
    where there is a lens."""

    apertures: int
    focuses: int
    coarse: int
    fine: int
    blur: bool = False


THOROUGH = Effort(apertures=5, focuses=5, coarse=12, fine=10, blur=True)
QUICK = Effort(apertures=3, focuses=3, coarse=8, fine=1)


@dataclass(frozen=True)
class Frame:
    """What signed circles refer to: a range of disparities (1 / scene unit), and an image width in pixels.

    A lens is (near, far) here: the signed circles at both ends as shares of the width, whose pull on the picture is
    alike in strength and goes through zero without a jump, where F has no meaning when A is small.
    """

    disparities: DisparityRange
    width: int

    def lens(self, ends: np.ndarray) -> PhysicalLens:
        """The lens with these signed circles at q_min and q_max. The blur of both signs is one."""
        low, high = float(ends[0]), float(ends[1])
        slope = high - low
        least = 1e-6  # an even blur is a focus far away: nearly no slope, as none would leave no focus
        if abs(slope) < least:
            slope = math.copysign(least, slope)
        focus = self.disparities.q_min - low / slope * self.disparities.extent
        return PhysicalLens(abs(slope) * self.width / self.disparities.extent, focus, self.width)

    def ends(self, lens: PhysicalLens) -> np.ndarray:
        """(2,) signed circles of a lens, the inverse of `lens`."""
        ends = np.array([self.disparities.q_min, self.disparities.q_max])
        return np.asarray(lens.signed_radius(ends, self.width)) / self.width


def lens_grid(frame: Frame, learned: PhysicalLens | None, effort: Effort) -> list[PhysicalLens]:
    """Lenses to begin with: none of the blur, and every aperture with every focus, those of `learned` among them."""
    first = 0 if effort.apertures == len(APERTURES) else 1
    disparities, width = frame.disparities, frame.width
    apertures = [COC_FRACTION * a * width / disparities.extent for a in APERTURES[first : first + effort.apertures]]
    focuses = list(np.linspace(disparities.q_min, disparities.q_max, effort.focuses))
    if learned is not None:
        apertures.append(learned.aperture * width / learned.width)
        # A focus far outside would blur all alike, whatever the aperture.
        focuses.append(
            float(
                np.clip(
                    learned.focus_disparity,
                    disparities.q_min - disparities.extent,
                    disparities.q_max + disparities.extent,
                )
            )
        )
    lenses = [PhysicalLens(float(a), float(f), width) for a in apertures for f in focuses if a > 0]
    return [PhysicalLens(0.0, float(focuses[0]), width), *lenses]


@dataclass(frozen=True, eq=False)
class Found:
    """The best of a search, and its image; renders: how many images were asked for."""

    at: np.ndarray
    cost: float
    image: np.ndarray
    renders: int


def simplex(
    render: Callable[[np.ndarray], np.ndarray],
    cost: Cost,
    start: np.ndarray,
    most: int,
    step: float,
) -> Found:
    """Nelder and Mead's simplex from `start`, at most `most` images, `start`'s among them. step: the first along each
    coordinate."""
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
        asked = minimize(
            value,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": corners, "maxfev": most, "xatol": LEAST_STEP / 10, "fatol": 0.0},
        ).nfev
    return Found(best[0].at, best[0].cost, best[0].image, asked)


def best_sigma(blurred: Callable[[float], np.ndarray], cost: Cost, largest: float) -> tuple[float, np.ndarray]:
    """(sigma, image): the Gaussian blur of least cost, 0 to `largest` pixels: a grid, halved five times at its best."""
    tried: dict[float, float] = {}

    def value(sigma: float) -> float:
        if sigma not in tried:
            tried[sigma] = cost(blurred(sigma))
        return tried[sigma]

    # Steps that grow with sigma, as does the blur that can be told from its neighbour.
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
