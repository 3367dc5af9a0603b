"""The error of the edges on the CPU: absolute differences between the errors of neighbouring pixels, and its gradient.

Rows run in parallel; a sum is kept for every row and all are added in order, so the number of threads changes no bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import cached

HALF = np.float32(0.5)
ZERO = np.float32(0)


@cached
@njit(error_model="numpy", parallel=True)
def edges(p, t, weight, channels, sums):
    """Fill sums (H, 2): for each row the weighted |e(x + 1) - e(x)| of its pixels, and |e(y + 1) - e(y)| from this row
    to the next, with e = p - t.

    p, t: (H, W channels) float32. weight: (H, W), the mean of two pixels' weights counts; or empty.
    """
    height, count = p.shape
    for y in prange(height):
        across, down = 0.0, 0.0
        for j in range(count - channels):
            k = j + channels
            step = abs((p[y, k] - t[y, k]) - (p[y, j] - t[y, j]))
            if weight.size > 0:
                step *= HALF * (weight[y, j // channels] + weight[y, k // channels])
            across += step
        if y + 1 < height:
            for j in range(count):
                step = abs((p[y + 1, j] - t[y + 1, j]) - (p[y, j] - t[y, j]))
                if weight.size > 0:
                    step *= HALF * (weight[y, j // channels] + weight[y + 1, j // channels])
                down += step
        sums[y, 0], sums[y, 1] = across, down


@cached
@njit(error_model="numpy", parallel=True)
def add_edges_gradient(p, t, weight, channels, scale_across, scale_down, gradient):
    """Add to gradient (H, W channels) that of scale_across times the sum in rows, and scale_down times that in columns,
    by p. The other arguments are those of `edges`."""
    height, count = p.shape
    for y in prange(height):
        for j in range(count):
            error = p[y, j] - t[y, j]
            across, down = ZERO, ZERO
            if j >= channels:
                k = j - channels
                across += _slope(error, p[y, k] - t[y, k], weight, y, j // channels, y, k // channels)
            if j + channels < count:
                k = j + channels
                across += _slope(error, p[y, k] - t[y, k], weight, y, j // channels, y, k // channels)
            if y > 0:
                down += _slope(error, p[y - 1, j] - t[y - 1, j], weight, y, j // channels, y - 1, j // channels)
            if y + 1 < height:
                down += _slope(error, p[y + 1, j] - t[y + 1, j], weight, y, j // channels, y + 1, j // channels)
            gradient[y, j] += scale_across * across + scale_down * down


@njit(error_model="numpy", inline="always")
def _slope(error, other, weight, y, x, y_other, x_other):
    """The derivative of the weighted |error - other| by `error`: 0 where the two are equal."""
    step = error - other
    sign = np.float32(step > ZERO) - np.float32(step < ZERO)
    return sign if weight.size == 0 else sign * (HALF * (weight[y, x] + weight[y_other, x_other]))
