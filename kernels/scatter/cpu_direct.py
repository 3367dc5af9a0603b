"""The direct form: every source visits every pixel of its circle of confusion, O(R^2) per pixel.

A row of sources is gathered into vectors of targets, one row offset at a time; for a disc the target rows at equal
distance above and below use the same sums. Bands of source rows write to buffers of their own, merged in
a fixed order: no atomics, and the same bits whatever the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import splat8
from dofbench.runtime.simd_memory import load8, store8

from .cpu_pack import BLOCK, EXPONENTIAL, PLANES, RATIONAL, SUMS, Edges, Geometry, half_width, logistic2
from .op import COLOURS

STRIP = 64  # columns of a task: so few that the target rows to which a source row writes stay in the cache
LANES = 8
_ONE = np.float32(1.0)


@internal(error_model="numpy")
def _accumulate(sums, weight, planes, at, stride):
    return (
        sums[0] + weight * load8(planes, at + stride),
        sums[1] + weight * load8(planes, at + 2 * stride),
        sums[2] + weight * load8(planes, at + 3 * stride),
        sums[3] + weight * load8(planes, at + 4 * stride),
    )


@internal(error_model="numpy")
def _gather_rational(sums, planes, at, stride, low, high, outer, entry):
    for dx in range(low, high + 1):
        weight = _ONE / (_ONE + load8(planes, at + dx) * outer[entry + dx])
        sums = _accumulate(sums, weight, planes, at + dx, stride)
    return sums


@internal(error_model="numpy")
def _gather_exponential(sums, planes, at, stride, low, high, outer, slope, entry):
    for dx in range(low, high + 1):
        weight = logistic2(outer[entry + dx] - slope[entry + dx] * load8(planes, at + dx))
        sums = _accumulate(sums, weight, planes, at + dx, stride)
    return sums


@internal(error_model="numpy")
def _gather_stopped(sums, planes, at, stride, low, high, outer, slope, entry, stop, opacity):
    for dx in range(low, high + 1):
        radius, start, steep = load8(planes, at + dx), outer[entry + dx], slope[entry + dx]
        hole = logistic2(start - (stop * steep) * radius)
        weight = logistic2(start - steep * radius) * (_ONE - opacity * hole)
        sums = _accumulate(sums, weight, planes, at + dx, stride)
    return sums


@internal(error_model="numpy")
def _add(buffer, at, sums):
    store8(buffer, at, load8(buffer, at) + sums[0])
    store8(buffer, at + STRIP, load8(buffer, at + STRIP) + sums[1])
    store8(buffer, at + 2 * STRIP, load8(buffer, at + 2 * STRIP) + sums[2])
    store8(buffer, at + 3 * STRIP, load8(buffer, at + 3 * STRIP) + sums[3])


@internal(error_model="numpy")
def farthest_reach(reach, y, block, around):
    """Largest reach, pixels, of those sources of row y that reach the targets of `block`; negative if none does."""
    farthest = np.float32(-1.0)
    for other in range(max(0, block - around), min(reach.shape[1], block + around + 1)):
        if reach[y, other] > farthest and reach[y, other] >= (abs(other - block) - 1) * BLOCK + 1:
            farthest = reach[y, other]
    return farthest


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _spread(planes, reach, sizes, rows, kind, folded, outer, slope, stop, opacity):
    """Buffers (bands of `rows` source rows, strips, target rows of the band, SUMS, STRIP)."""
    height, width, stride, pad = sizes.height, sizes.width, sizes.stride, sizes.pad
    reach_y, reach_x = sizes.reach_y, sizes.reach_x
    strips, bands = -(-width // STRIP), -(-height // rows)
    buffers = np.empty((bands, strips, (rows + 2 * reach_y) * SUMS * STRIP), np.float32)
    around = -(-reach_x // BLOCK) + 1
    columns = 2 * reach_x + 1
    first = 0 if folded else -reach_y
    for task in prange(strips * bands):
        strip, part = task % strips, task // strips
        buffer = buffers[part, strip]
        buffer[:] = 0
        for y in range(part * rows, min(height, part * rows + rows)):
            for x in range(strip * STRIP, min(width, strip * STRIP + STRIP), BLOCK):
                block = (pad + x) // BLOCK
                farthest = farthest_reach(reach, y, block, around)
                at = y * PLANES * stride + pad + x
                for dy in range(first, reach_y + 1):
                    half = min(half_width(farthest, dy), reach_x)
                    below, above = y + dy < height and y + dy >= 0, folded and dy > 0 and y - dy >= 0
                    if half < 0 or not (below or above):
                        continue
                    low, high = max(-half, 1 - BLOCK - x), min(half, width - 1 - x)
                    entry = (dy - first) * columns + reach_x
                    to = (y + dy - part * rows + reach_y) * SUMS * STRIP + x - strip * STRIP
                    for i in range(0, BLOCK, LANES):
                        zero = splat8(np.float32(0.0))
                        sums = (zero, zero, zero, zero)
                        if kind == RATIONAL:
                            sums = _gather_rational(sums, planes, at + i, stride, low, high, outer, entry)
                        elif kind == EXPONENTIAL:
                            sums = _gather_exponential(sums, planes, at + i, stride, low, high, outer, slope, entry)
                        else:
                            sums = _gather_stopped(
                                sums, planes, at + i, stride, low, high, outer, slope, entry, stop, opacity
                            )
                        if below:
                            _add(buffer, to + i, sums)
                        if above:
                            _add(buffer, to + i - 2 * dy * SUMS * STRIP, sums)
    return buffers


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _merge(buffers, height, width, rows, reach_y):
    """Sum the buffers that cover each row, in order, and divide: blurred (H, W, COLOURS), total (H, W)."""
    blurred = np.empty((height, width, COLOURS), np.float32)
    total = np.empty((height, width), np.float32)
    bands, strips = buffers.shape[0], buffers.shape[1]
    for y in prange(height):
        line = np.empty(SUMS * STRIP, np.float32)
        first, last = max(0, (y - reach_y) // rows), min(bands - 1, (y + reach_y) // rows)
        for strip in range(strips):
            line[:] = 0
            for part in range(first, last + 1):
                at = (y - part * rows + reach_y) * SUMS * STRIP
                line += buffers[part, strip, at : at + SUMS * STRIP]
            for column in range(min(STRIP, width - strip * STRIP)):
                x = strip * STRIP + column
                weight = line[COLOURS * STRIP + column]
                total[y, x] = weight
                for channel in range(COLOURS):
                    blurred[y, x, channel] = line[channel * STRIP + column] / weight
    return blurred, total


def forward(planes: np.ndarray, reach: np.ndarray, sizes: Geometry, edge: Edges) -> tuple[np.ndarray, np.ndarray]:
    """Blurred colours (H, W, COLOURS) and total weight (H, W); planes, reach: from `pack_sources`."""
    # Bands of this height overlap little, so merging is cheap, and there are still enough bands for several threads.
    rows = max(48, 2 * sizes.reach_y)
    buffers = _spread(
        planes, reach, sizes, rows, edge.kind, edge.folded, edge.outer, edge.slope, edge.stop, edge.opacity
    )
    return _merge(buffers, sizes.height, sizes.width, rows, sizes.reach_y)
