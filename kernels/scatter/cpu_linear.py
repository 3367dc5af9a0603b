"""The linear form: where the radius varies little, all but the rim of a circle of confusion is a plain row sum.

Along a row, a disc is a run of equal weights with soft ends (kernels.md). Runs are differences of a row's
prefix sum, one subtraction whatever their length; only the soft ends visit their pixels one by one, which makes
the cost O(R) a pixel. Sources (forward) or targets (backward) are done in vectors over x, so a run is what all
of a vector's pixels have in common: where radii of neighbours differ, the ends get longer, and with pure
noise for a radius nothing but ends is left. Prefix sums are float64, so that a highlight leaves no trace
in the dark pixels after it.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from .cpu_pack import BLOCK, SUMS, half_width


@njit(parallel=True, cache=True, error_model="numpy")
def prefix_sums(planes, height, in_row, first, stride):
    """Running sums along x of planes `first` ... `first + SUMS - 1` of every row.

    planes: flat, (height, in_row, stride). Returns (height, SUMS, stride) float64, flat; element x is the
    sum of everything before x.
    """
    sums = np.empty((height, SUMS, stride), np.float64)
    for y in prange(height):
        a = b = c = d = 0.0
        at = (y * in_row + first) * stride
        for x in range(stride):
            sums[y, 0, x], sums[y, 1, x], sums[y, 2, x], sums[y, 3, x] = a, b, c, d
            a += planes[at + x]
            b += planes[at + stride + x]
            c += planes[at + 2 * stride + x]
            d += planes[at + 3 * stride + x]
    return sums.reshape(-1)


@njit(cache=True, error_model="numpy")
def add_run(to, sums, start, stride, low, high):
    """Add to `to`, (SUMS, BLOCK), the sums over offsets low ... high; `start`: the first plane in `sums`."""
    for plane in range(SUMS):
        after, before = start + plane * stride + high + 1, start + plane * stride + low
        for i in range(BLOCK):
            to[plane * BLOCK + i] += np.float32(sums[after + i] - sums[before + i])


@njit(cache=True, error_model="numpy")
def split_at_runs(soft, runs, reach, core, y, block, dy):
    """Cut the offsets soft[0] of a block of targets into pieces to visit and runs of full weight.

    Sources of row y; targets `dy` rows away. Offsets 16 q ... 16 q + 15 see the sources of two neighbouring
    blocks. Overwrites soft and runs, (n, 2) first and last offset; returns how many there are of each.
    """
    low, high = soft[0, 0], soft[0, 1]
    soft_count = run_count = 0
    for q in range(low // BLOCK, high // BLOCK + 1):
        a, b = block + q, block + q + 1
        half = half_width(max(reach[y, a], reach[y, b]), dy)
        start, end = max(low, q * BLOCK, -half), min(high, q * BLOCK + BLOCK - 1, half)
        if start > end:
            continue
        full = half_width(min(core[y, a], core[y, b]), dy)
        run_start, run_end = max(start, -full), min(end, full)
        if run_start > run_end:
            run_start, run_end = end + 1, end
        soft_count = _append(soft, soft_count, start, run_start - 1)
        run_count = _append(runs, run_count, run_start, run_end)
        soft_count = _append(soft, soft_count, run_end + 1, end)
    return soft_count, run_count


@njit(cache=True, error_model="numpy")
def _append(pieces, count, start, end):
    """Append start ... end, joined to the last piece where it continues it; the number of pieces."""
    if start > end:
        return count
    if count > 0 and pieces[count - 1, 1] == start - 1:
        pieces[count - 1, 1] = end
        return count
    pieces[count, 0], pieces[count, 1] = start, end
    return count + 1
