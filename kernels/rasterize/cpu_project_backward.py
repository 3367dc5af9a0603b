"""The gradient of projection: the sums over each Gaussian's intersections, and the walk over all Gaussians, eight of
those with a gradient at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, splat8
from dofbench.runtime.simd_memory import load8, prefetch, store8

from . import cpu_layout as layout
from .cpu_footprint import ZERO
from .cpu_gaussian_backward import backward_rows
from .cpu_layout import CHUNKS
from .cpu_sh import TERMS, prefetch_terms

SLOT = layout.SLOT
_AHEAD = 32  # intersections are prefetched so many Gaussians ahead


@internal(forceinline=True)
def prefetch_places(intersections, i):
    """Ask for Gaussian i's intersections, which are scattered in memory."""
    gradients, width, blended, offsets, places, begins = intersections
    for point in range(begins.size):
        begin = begins[point]
        for k in range(begin + offsets[point, i], begin + offsets[point, i + 1]):
            place = begin + places[k]
            prefetch(gradients, place * width)
            prefetch(blended, place)


@internal(forceinline=True)
def sum_places(intersections, i, sums, row):
    """Sum Gaussian i's intersections in the order of its tiles, of one lens point after the other, into a row of
    `sums`; returns whether there is any that was blended."""
    gradients, width, blended, offsets, places, begins = intersections
    low, middle, high = splat8(ZERO), splat8(ZERO), splat8(ZERO)
    found = False
    for point in range(begins.size):
        begin = begins[point]
        for k in range(begin + offsets[point, i], begin + offsets[point, i + 1]):
            place = begin + places[k]
            if blended[place] != 0:
                found = True
                base = place * width
                low += load8(gradients, base)
                middle += load8(gradients, base + LANES)
                if width > 2 * LANES:
                    high += load8(gradients, base + 2 * LANES)
    store8(sums, row * SLOT, low)
    store8(sums, row * SLOT + LANES, middle)
    store8(sums, row * SLOT + 2 * LANES, high)
    return found


@internal(forceinline=True)
def _zero(array, width, first, stop):
    if array.size > 0:
        for k in range(width * first, width * stop):
            array[k] = ZERO


@internal(error_model="numpy")
def zero_rows(outputs, rest, first, stop):
    """Set the gradients of the Gaussians first … stop - 1 to zero."""
    _zero(outputs[0], 3, first, stop)
    _zero(outputs[1], 3, first, stop)
    _zero(outputs[2], 4, first, stop)
    _zero(outputs[3], 1, first, stop)
    _zero(outputs[4], 3, first, stop)
    _zero(outputs[5], 3 * rest, first, stop)
    _zero(outputs[6], 1, first, stop)
    _zero(outputs[7], 1, first, stop)
    _zero(outputs[8], 2, first, stop)
    _zero(outputs[9], 2, first, stop)


@internal(error_model="numpy")
def fill_up(rows, sums, count):
    """Fill eight rows up with copies of the last of `count`."""
    for k in range(count, LANES):
        rows[k] = rows[count - 1]
        for number in range(SLOT):
            sums[k * SLOT + number] = sums[(count - 1) * SLOT + number]


@internal(error_model="numpy")
def backward_part(inputs, rest, degree, geometry, view, records, intersections, first, stop, outputs):
    """Compute the gradients of the Gaussians first … stop - 1."""
    grad_2d, abs_grad_2d = outputs[8], outputs[9]
    rows, sums = np.empty(2 * LANES, np.int32), np.empty(2 * LANES * SLOT, np.float32)
    mean_2d = np.empty(2 * LANES, np.float32)
    basis, pulls = np.empty(TERMS * LANES, np.float32), np.empty(TERMS * LANES, np.float32)
    coefficients = np.empty(3 * TERMS * LANES, np.float32)
    waiting, empty = 0, first  # rows that wait for eight; the first Gaussian of those before i without a gradient
    for i in range(first, stop):
        prefetch_places(intersections, min(i + _AHEAD, stop - 1))
        if sum_places(intersections, i, sums, waiting):
            rows[waiting] = i
            waiting += 1
            prefetch_terms(inputs[5], rest, i)
            zero_rows(outputs, rest, empty, i)
            empty = i + 1
        while waiting == 2 * LANES or (waiting > 0 and i == stop - 1):
            fill_up(rows, sums, waiting)
            backward_rows(
                inputs, rest, degree, geometry, view, records, rows, sums, outputs[:8], mean_2d, basis, pulls,
                coefficients,
            )  # fmt: skip
            for lane in range(LANES):
                if grad_2d.size > 0:
                    grad_2d[2 * rows[lane]] = mean_2d[lane]
                    grad_2d[2 * rows[lane] + 1] = mean_2d[LANES + lane]
                if abs_grad_2d.size > 0:
                    abs_grad_2d[2 * rows[lane]] = sums[lane * SLOT + layout.ABS_X]
                    abs_grad_2d[2 * rows[lane] + 1] = sums[lane * SLOT + layout.ABS_Y]
            waiting = max(waiting - LANES, 0)
            for k in range(waiting):
                rows[k] = rows[k + LANES]
            for k in range(waiting * SLOT):
                sums[k] = sums[k + LANES * SLOT]
    zero_rows(outputs, rest, empty, stop)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def project_backward(inputs, rest, degree, geometry, view, records, intersections, outputs):
    """Reduce the intersections' gradients to Gaussians and on to the parameters.

    inputs: as in `project`, margin empty. intersections: gradients, how many floats each has, which of them were
    blended, of each lens point the offsets of `fill_tiles`, (P, N + 1), and its places, one point's after the other,
    and where each point's begin; a view without lens points is one point. outputs: the gradients of the six
    parameters, of blur and of the radius by which lens points move a Gaussian, grad_2d and abs_grad_2d, all flat; that
    of blur is empty if blur is empty; the last three may be empty. For the radius's, the intersections hold
    S_POINT_XX … instead of sums of depth (cpu_layout).
    """
    n = inputs[3].size
    for chunk in prange(CHUNKS):
        first, stop = chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS
        backward_part(inputs, rest, degree, geometry, view, records, intersections, first, stop, outputs)
