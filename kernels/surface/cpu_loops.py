"""Loops over pixels and samples for the CPU. Sums are taken in double precision, of pieces of a fixed size, so that
their bits don't depend on the number of threads."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import splat8
from dofbench.runtime.simd_functions import min8
from dofbench.runtime.simd_memory import load8, store8

_PIECE = 4096  # numbers a task
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_INFINITY = np.float32(np.inf)
_LANES = 8


@internal(error_model="numpy")
def _least(values):
    whole = values.size - values.size % _LANES
    lanes = splat8(_INFINITY)
    for i in range(0, whole, _LANES):
        lanes = min8(lanes, load8(values, i))
    ends = np.empty(_LANES, np.float32)
    store8(ends, 0, lanes)
    least = ends.min()
    for i in range(whole, values.size):
        least = min(least, values[i])
    return least


@cached
@njit(parallel=PRANGE, error_model="numpy")
def disparities(depth, alpha, least_alpha):
    """`reference.surface` of flat arrays."""
    result = np.empty_like(depth)
    for i in prange(depth.size):
        there = (alpha[i] > least_alpha) & (depth[i] > _ZERO)
        result[i] = _ONE / depth[i] if there else _INFINITY
    far = _least(result)
    far = _ZERO if np.isinf(far) else far
    for i in prange(depth.size):
        there = (alpha[i] > least_alpha) & (depth[i] > _ZERO)
        result[i] = result[i] if there else far
    return result


@cached
@njit(parallel=PRANGE, error_model="numpy")
def disparities_gradient(gradient, depth, alpha, least_alpha):
    """By depth, flat."""
    result = np.empty_like(depth)
    for i in prange(depth.size):
        there = (alpha[i] > least_alpha) & (depth[i] > _ZERO)
        result[i] = -gradient[i] / (depth[i] * depth[i]) if there else _ZERO
    return result


@internal(error_model="numpy")
def _clipped(x, least, most):
    # Comparisons with NaN are false, so NaN stays NaN.
    x = least if x < least else x
    return most if x > most else x


@cached
@njit(parallel=PRANGE, error_model="numpy")
def circles(disparity, slope, offset, low, extent, scale, least, most):
    """`reference.circle` of a flat array."""
    result = np.empty_like(disparity)
    for i in prange(disparity.size):
        result[i] = scale * (slope * _clipped((disparity[i] - low) / extent, least, most) + offset)
    return result


@cached
@njit(parallel=PRANGE, error_model="numpy")
def circles_gradient(gradient, disparity, slope, low, extent, scale, least, most):
    """By disparity, flat; by slope; by offset."""
    result = np.empty_like(disparity)
    pieces = -(-disparity.size // _PIECE)
    sums = np.zeros((pieces, 2))
    factor = scale * slope / extent
    for piece in prange(pieces):
        by_slope = by_offset = 0.0
        for i in range(piece * _PIECE, min(disparity.size, piece * _PIECE + _PIECE)):
            x = (disparity[i] - low) / extent
            result[i] = gradient[i] * factor if (x >= least) & (x <= most) else _ZERO
            by_slope += np.float64(gradient[i]) * np.float64(_clipped(x, least, most))
            by_offset += np.float64(gradient[i])
        sums[piece, 0] = by_slope
        sums[piece, 1] = by_offset
    by_slope = by_offset = 0.0
    for piece in range(pieces):
        by_slope += sums[piece, 0]
        by_offset += sums[piece, 1]
    return result, scale * by_slope, scale * by_offset


@internal(error_model="numpy")
def _difference(rendered, known, inverse_extent):
    if inverse_extent == _ZERO:
        return rendered - known
    return (_ONE / rendered - _ONE / known) * inverse_extent


@cached
@njit(parallel=PRANGE, error_model="numpy")
def depth_error(depth, alpha, rows, columns, known, shares, weight, least_alpha, inverse_extent, squared):
    """The sum of the samples' errors, that of their shares, and how many lie outside the image, which isn't looked at
    there; see `reference.known_depth`. shares, weight: empty for none. inverse_extent: 0 for errors in scene units."""
    height, width = depth.shape
    pieces = -(-known.size // _PIECE)
    sums = np.zeros((pieces, 3))
    for piece in prange(pieces):
        total = counted = outside = 0.0
        for i in range(piece * _PIECE, min(known.size, piece * _PIECE + _PIECE)):
            row, column = rows[i], columns[i]
            if not (0 <= row < height and 0 <= column < width):
                outside += 1.0
                continue
            if not alpha[row, column] > least_alpha:
                continue
            share = shares[i] if shares.size else _ONE
            difference = _difference(depth[row, column], known[i], inverse_extent)
            error = share * (difference * difference if squared else abs(difference))
            total += float(error * weight[row, column] if weight.size else error)
            counted += float(share)
        # One by one: a row as an array takes four seconds to compile.
        sums[piece, 0], sums[piece, 1], sums[piece, 2] = total, counted, outside
    total = counted = outside = 0.0
    for piece in range(pieces):
        total += sums[piece, 0]
        counted += sums[piece, 1]
        outside += sums[piece, 2]
    return total, counted, outside


@cached
@njit(error_model="numpy")
def depth_error_gradient(
    depth, alpha, rows, columns, known, shares, weight, least_alpha, inverse_extent, squared, factor
):
    """`factor` times the gradient of the errors' sum by depth, (H, W). On one thread, as several samples may lie in one
    pixel."""
    result = np.zeros_like(depth)
    for i in range(known.size):
        row, column = rows[i], columns[i]
        if not alpha[row, column] > least_alpha:
            continue
        z = depth[row, column]
        difference = _difference(z, known[i], inverse_extent)
        slope = np.float32(2.0) * difference if squared else np.sign(difference)
        if inverse_extent != _ZERO:
            slope *= -inverse_extent / (z * z)
        share = shares[i] if shares.size else _ONE
        if weight.size:
            share *= weight[row, column]
        result[row, column] += factor * share * slope
    return result
