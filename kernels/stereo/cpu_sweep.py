"""The sweep of `cpu.py`: correlation of every pixel with the other views at every plane.

Tiles run in parallel and write to separate places. Within a tile a source is warped once per plane, and the sums over a
window are computed for eight columns at a time, first down and then along, so only the reads of the warp are scalar.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, lanes8, select8, splat8
from dofbench.runtime.simd_functions import floor8, max8, min8, sqrt8
from dofbench.runtime.simd_memory import gather8, gather_pairs8, load8, store8, store_whole8

from .op import FLOOR, UNKNOWN

ROWS, COLUMNS = 32, 256  # size of a tile
PLANES = 8  # number of planes that a tile finishes together, which are adjacent in the result
_F = np.float32
_ZERO, _ONE, _HALF, _INFINITY = _F(0), _F(1), _F(0.5), _F(np.inf)


@internal(error_model="numpy")
def _warp(image, height, width, matrix, disparity, top, left, rows, wide, warped, inside, pitch, at, along, down):
    """Fill warped (rows, wide) with the source seen at the plane; row 0 and column 0 are pixel (top, left).

    image: flat, with its last row and column twice. inside: 1 where that is in the source, else 0. pitch: floats from
    a row to the next in both. at, along, down: scratch of a row.
    """
    last_x, last_y, step = _F(width - 1), _F(height - 1), _F(width + 1)
    broad, high = _F(width), _F(height)
    a, b, c = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    for row in range(rows):
        y = _F(top + row) + _HALF
        u0 = matrix[0, 1] * y + (matrix[0, 2] + matrix[0, 3] * disparity)
        v0 = matrix[1, 1] * y + (matrix[1, 2] + matrix[1, 3] * disparity)
        w0 = matrix[2, 1] * y + (matrix[2, 2] + matrix[2, 3] * disparity)
        start = row * pitch
        for column in range(0, wide, LANES):
            x = lanes8() + (_F(left + column) + _HALF)
            w = c * x + w0
            share = _ONE / w
            u = (a * x + u0) * share
            v = (b * x + v0) * share
            there = (w > _ZERO) & (u >= _ZERO) & (u < broad) & (v >= _ZERO) & (v < high)
            store8(inside, start + column, select8(there, _ONE, _ZERO))
            u = min8(max8(u - _HALF, _ZERO), last_x)  # 0 for NaN too
            v = min8(max8(v - _HALF, _ZERO), last_y)
            first, upper = floor8(u), floor8(v)
            store_whole8(at, column, upper * step + first)
            store8(along, column, u - first)
            store8(down, column, v - upper)
        for column in range(0, wide, LANES):
            x = load8(along, column)
            one, right = gather_pairs8(image, at, column, 0)
            two, below = gather_pairs8(image, at, column, width + 1)
            one += x * (right - one)
            two += x * (below - two)
            store8(warped, start + column, one + load8(down, column) * (two - one))


@internal(error_model="numpy")
def _down(warped, patch, start, pitch, window, wide, sums):
    """Sums over the window's rows from index `start` on of the source, its square and its product with the patch."""
    for column in range(0, wide, LANES):
        plain, square, mixed = splat8(_ZERO), splat8(_ZERO), splat8(_ZERO)
        at = start + column
        for _ in range(len(window)):
            own, other = load8(patch, at), load8(warped, at)
            plain += other
            square += other * other
            mixed += other * own
            at += pitch
        store8(sums, column, plain)
        store8(sums, pitch + column, square)
        store8(sums, 2 * pitch + column, mixed)


@internal(error_model="numpy")
def _further(warped, patch, start, pitch, window, wide, sums):
    """`_down`, updated from the sums of the row above: the row that leaves the window is subtracted, the new one
    added."""
    gone, come = start - pitch, start + (len(window) - 1) * pitch
    for column in range(0, wide, LANES):
        old, new = load8(warped, gone + column), load8(warped, come + column)
        store8(sums, column, load8(sums, column) + (new - old))
        at = pitch + column
        store8(sums, at, load8(sums, at) + (new - old) * (new + old))
        at += pitch
        store8(sums, at, load8(sums, at) + (new * load8(patch, come + column) - old * load8(patch, gone + column)))


@internal(error_model="numpy")
def _correlate(sums, pitch, window, width, own, deviation, inside, row, shift, largest, layer, best):
    """Compute the correlation of a row of pixels from the vertical sums of its windows, and insert it among the `best`
    largest."""
    share = _ONE / _F(len(window) * len(window))
    for column in range(0, width, LANES):
        plain, square, mixed = splat8(_ZERO), splat8(_ZERO), splat8(_ZERO)
        for k in range(len(window)):
            plain += load8(sums, column + k)
            square += load8(sums, pitch + column + k)
            mixed += load8(sums, 2 * pitch + column + k)
        at = row + column
        plain *= share
        variance = max8(square * share - plain * plain, _ZERO) + _F(FLOOR)
        score = (mixed * share - load8(own, at) * plain) / (load8(deviation, at) * sqrt8(variance))
        score = select8(load8(inside, shift + column) > _ZERO, score, -_INFINITY)
        for _ in range(best):
            kept = load8(largest, at)
            better = score > kept
            store8(largest, at, select8(better, score, kept))
            score = select8(better, kept, score)
            at += layer


@internal(error_model="numpy")
def _mean_of_best(largest, layer, best, first, count, out):
    """Write the mean of the largest scores, of which there may be fewer than `best`, into out, from index `first`
    on."""
    for at in range(0, count, LANES):
        total, seen = splat8(_ZERO), splat8(_ZERO)
        for k in range(best):
            value = load8(largest, k * layer + at)
            there = value > -_INFINITY
            total += select8(there, value, _ZERO)
            seen += select8(there, _ONE, _ZERO)
        store8(out, first + at, select8(seen > _ZERO, total / max8(seen, _ONE), _F(UNKNOWN)))


@cached
@njit(parallel=PRANGE, error_model="numpy")
def sweep(reference, sources, maps, disparities, radius, window, best, scores):
    """Fill scores (H, W, D). CENTRE has been subtracted from the images, and the last row and column of the sources are
    repeated once."""
    height, width, count = scores.shape
    across = -(-width // COLUMNS)
    side = len(window)
    images, flat = sources.reshape(len(sources), -1), scores.reshape(-1)
    source_height, source_width = sources.shape[1] - 1, sources.shape[2] - 1
    for tile in prange(across * -(-height // ROWS)):
        top, left = tile // across * ROWS, tile % across * COLUMNS
        rows, columns = min(ROWS, height - top), min(COLUMNS, width - left)
        # Rows of whole vectors, extended on both sides by the reach of a window and by one more vector.
        padded = -(-columns // LANES) * LANES
        pitch = -(-(padded + 2 * radius) // LANES) * LANES + LANES
        layer = rows * padded
        patch = np.zeros((rows + 2 * radius) * pitch + LANES, np.float32)
        for row in range(rows + 2 * radius):
            y = min(max(top + row - radius, 0), height - 1)
            for column in range(columns + 2 * radius):
                x = min(max(left + column - radius, 0), width - 1)
                patch[row * pitch + column] = reference[y, x]
        warped, inside = np.zeros_like(patch), np.zeros_like(patch)
        at, along, down = np.empty(pitch, np.int32), np.empty(pitch, np.float32), np.empty(pitch, np.float32)
        sums = np.zeros(3 * pitch + LANES, np.float32)
        own, deviation = np.ones(layer, np.float32), np.ones(layer, np.float32)
        share = _ONE / _F(side * side)
        for row in range(rows):
            _down(patch, patch, row * pitch, pitch, window, padded + 2 * radius, sums)
            for column in range(padded):
                plain, square = _ZERO, _ZERO
                for k in range(len(window)):
                    plain += sums[column + k]
                    square += sums[pitch + column + k]
                plain *= share
                variance = square * share - plain * plain
                own[row * padded + column] = plain
                deviation[row * padded + column] = np.sqrt((variance if variance > _ZERO else _ZERO) + _F(FLOOR))
        largest = np.empty(best * layer, np.float32)
        together = np.empty(PLANES * layer, np.float32)
        for first in range(0, count, PLANES):
            planes = min(PLANES, count - first)
            for index in range(planes):
                largest[:] = -_INFINITY
                for source in range(len(maps)):
                    _warp(
                        images[source], source_height, source_width, maps[source], disparities[first + index],
                        top - radius, left - radius, rows + 2 * radius, pitch - LANES, warped, inside, pitch, at, along,
                        down,
                    )  # fmt: skip
                    for row in range(rows):
                        # Updated sums accumulate rounding errors, so every tile starts with fresh sums.
                        if row == 0:
                            _down(warped, patch, 0, pitch, window, padded + 2 * radius, sums)
                        else:
                            _further(warped, patch, row * pitch, pitch, window, padded + 2 * radius, sums)
                        _correlate(
                            sums, pitch, window, padded, own, deviation, inside, row * padded,
                            (row + radius) * pitch + radius, largest, layer, best,
                        )  # fmt: skip
                _mean_of_best(largest, layer, best, index * layer, layer, together)
            for row in range(rows):
                for column in range(columns):
                    goal = ((top + row) * width + left + column) * count + first
                    pixel = row * padded + column
                    if planes == PLANES:
                        store8(flat, goal, gather8(together, pixel, layer))
                    else:
                        for index in range(planes):
                            flat[goal + index] = together[index * layer + pixel]
