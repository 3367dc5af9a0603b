"""How many windows the scatter's linear form looks at, and what becomes of each, where all radii around are alike.

A tile goes through rows of windows of 16 offsets, and where it has to, of 4, and where it has to, through single
offsets (kernels/scatter/gpu_linear.py). Borders of the picture are left out, as they are in the direct form's places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dofbench.core.lens import ALPHA, ApertureShape

FINE, COARSE = 4, 16
BAND, FOCUS = 12.0 / (2 * ALPHA), 18.0 / (2 * ALPHA)  # how far tails are followed, pixels, kernels/scatter/gpu_rim.py


@dataclass(frozen=True)
class Windows:
    """Of one tile. rows: of offsets. coarse, fine: windows of 16 and of 4 offsets. coarse_met, fine_met: share of them
    that a source may reach, so that their sum is added, or they are divided. taps: single offsets."""

    rows: int
    coarse: int
    coarse_met: float
    fine: int
    fine_met: float
    taps: int


def reach_of(radius: float) -> int:
    """How far the scatter follows a source, whole pixels."""
    return math.ceil(max(radius + BAND, FOCUS))


@lru_cache
def windows(radius: float, blades: int) -> Windows:
    """Of a tile all of whose sources have this radius, pixels. blades: of the aperture, 0 for a disc."""
    shape, far = ApertureShape(blades=blades), reach_of(radius)
    shortest = math.cos(math.pi / blades) if blades else 1.0
    near, gone = radius - BAND / shortest, max(radius + BAND / shortest, FOCUS / shortest)
    rows = np.arange(-far, far + 1)
    columns = [math.isqrt(far * far - int(dy) ** 2) + 1 for dy in rows]
    first = [np.arange(-wide // COARSE * COARSE, wide + 1, COARSE) for wide in columns]
    dy, dx = np.repeat(rows, [len(one) for one in first]), np.concatenate(first)
    met, divided = _kinds(dx, dy, COARSE, near, gone, shape)
    fine_dx = (dx[divided][:, None] + np.arange(0, COARSE, FINE)).reshape(-1)
    fine_met, fine_divided = _kinds(fine_dx, np.repeat(dy[divided], COARSE // FINE), FINE, near, gone, shape)
    return Windows(
        rows=len(rows),
        coarse=len(dx),
        coarse_met=float(met.mean()),
        fine=len(fine_dx),
        fine_met=float(fine_met.mean()) if len(fine_dx) else 0.0,
        taps=FINE * int(fine_divided.sum()),
    )


def _kinds(
    dx: np.ndarray, dy: np.ndarray, wide: int, near: float, gone: float, shape: ApertureShape
) -> tuple[np.ndarray, np.ndarray]:
    """Whether a source may reach each window, and whether some reach it and don't count in full: `radii_through`
    (kernels/scatter/gpu_row_windows.py)."""
    last = dx + wide - 1
    if shape.blades:
        slack = 0.5 * (wide - 1) / math.cos(math.pi / shape.blades)
        middle = 0.5 * (_corner(dx, dy, shape) + _corner(last, dy, shape))
        least, most = middle - slack, middle + slack
    else:
        least = np.hypot(np.maximum(np.maximum(dx, -last), 0), dy)
        most = np.hypot(np.maximum(np.abs(dx), np.abs(last)), dy)
    return gone >= least, (gone >= least) & (most > near)


def _corner(dx: np.ndarray, dy: np.ndarray, shape: ApertureShape) -> np.ndarray:
    """The radius, along a corner, of an aperture whose rim goes through an offset."""
    return np.hypot(dx, dy) / shape.radius_factor(np.arctan2(dy, dx))
