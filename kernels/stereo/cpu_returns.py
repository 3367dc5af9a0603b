"""The check of `cpu.py` that projects pixels to another view and back, one pixel at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import cached


@cached
@njit(parallel=True, error_model="numpy")
def find_returns(depth, other, there, back, pixels, share, found):
    """Set found (H, W), initially False, to True where the other view sees the same surface; there, back: (3, 4)
    float64."""
    height, width = depth.shape
    for row in prange(height):
        for column in range(width):
            z = np.float64(depth[row, column])
            if z <= 0:
                continue
            x, y = column + 0.5, row + 0.5
            w = z * (there[2, 0] * x + there[2, 1] * y + there[2, 2]) + there[2, 3]
            if w <= 0:
                continue
            u = (z * (there[0, 0] * x + there[0, 1] * y + there[0, 2]) + there[0, 3]) / w
            v = (z * (there[1, 0] * x + there[1, 1] * y + there[1, 2]) + there[1, 3]) / w
            if not (u >= 0 and v >= 0 and u < other.shape[1] and v < other.shape[0]):
                continue
            w = np.float64(other[int(v), int(u)])
            if w <= 0:
                continue
            again = w * (back[2, 0] * u + back[2, 1] * v + back[2, 2]) + back[2, 3]
            if again <= 0 or not abs(again / z - 1) < share:
                continue
            x -= (w * (back[0, 0] * u + back[0, 1] * v + back[0, 2]) + back[0, 3]) / again
            y -= (w * (back[1, 0] * u + back[1, 1] * v + back[1, 2]) + back[1, 3]) / again
            if x * x + y * y < pixels * pixels:
                found[row, column] = True
