"""The gradient of projection: the sums over each Gaussian's intersections, and the walk over all Gaussians, eight at a
time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, splat8
from dofbench.runtime.simd_memory import load8, prefetch, store8

from . import cpu_layout as layout
from .cpu_footprint import ZERO
from .cpu_gaussian_backward import backward_block
from .cpu_layout import CHUNKS, tails_of
from .cpu_sh import TERMS

SLOT = layout.SLOT


@internal(forceinline=True)
def reduce_places(gradients, width, places, first, last, sums, lane):
    """The sum over one Gaussian's intersections, in the order of its tiles, into its row of `sums`."""
    low, middle, high = splat8(ZERO), splat8(ZERO), splat8(ZERO)
    for k in range(first, last):
        base = np.int64(places[k]) * width
        low += load8(gradients, base)
        middle += load8(gradients, base + LANES)
        if width > 2 * LANES:
            high += load8(gradients, base + 2 * LANES)
    store8(sums, lane * SLOT, low)
    store8(sums, lane * SLOT + LANES, middle)
    store8(sums, lane * SLOT + 2 * LANES, high)


@internal(error_model="numpy")
def zero_rows(array, n, i, count):
    """Set rows i … i + count - 1 of a flat array of n rows to zero; the array may be empty."""
    width = array.size // n
    for k in range(width * i, width * (i + count)):
        array[k] = ZERO


@internal(error_model="numpy")
def put_tail(array, n, tail):
    """Write a padded block back to the rows after the last full block; the inverse of `tail_of`."""
    start = n // LANES * LANES * (array.size // n)
    for k in range(start, array.size):
        array[k] = tail[k - start]


@internal(error_model="numpy")
def met_lanes(offsets, i, count):
    """Which of the Gaussians i … i + count - 1 met a tile; bit k is Gaussian i + k."""
    bits = 0
    for lane in range(count):
        if offsets[i + lane + 1] > offsets[i + lane]:
            bits |= 1 << lane
    return bits


@internal(error_model="numpy")
def backward_blocks(inputs, rest, tails, degree, geometry, view, records, intersections, first, stop, outputs):
    """Compute the gradients of the blocks first … stop - 1."""
    n = inputs[3].size
    gradients, width, offsets, places = intersections
    grad_2d, abs_grad_2d = outputs[8], outputs[9]
    sums = np.empty(LANES * SLOT, np.float32)
    mean_2d = np.empty(2 * LANES, np.float32)
    basis, pulls = np.empty(TERMS * LANES, np.float32), np.empty(TERMS * LANES, np.float32)
    last = tails_of(outputs[:9], n)
    for block in range(first, stop):
        i = block * LANES
        count = min(LANES, n - i)
        seen = met_lanes(offsets, i, count)
        if seen == 0:  # no tile met them
            for array in outputs:
                zero_rows(array, n, i, count)
            continue
        for k in range(sums.size):
            sums[k] = ZERO
        # The next block's intersections are scattered in memory; prefetching them now hides the latency behind this
        # block.
        for k in range(np.int64(offsets[i + count]), np.int64(offsets[min(i + 2 * LANES, n)])):
            prefetch(gradients, np.int64(places[k]) * width)
        for lane in range(count):
            begin, end = np.int64(offsets[i + lane]), np.int64(offsets[i + lane + 1])
            reduce_places(gradients, width, places, begin, end, sums, lane)
        # One call with chosen arguments: a second call would be a second copy to compile.
        place, eight, found = (i, inputs, outputs[:9]) if count == LANES else (0, tails, last)
        backward_block(
            eight, rest, degree, geometry, view, place, records, i, seen, sums, found, mean_2d, basis, pulls
        )  # fmt: skip
        if count < LANES:
            for k in range(8):
                put_tail(outputs[k], n, last[k])
        if grad_2d.size > 0:
            for lane in range(count):
                met = (seen >> lane) & 1 != 0
                grad_2d[2 * (i + lane)] = mean_2d[lane] if met else ZERO
                grad_2d[2 * (i + lane) + 1] = mean_2d[LANES + lane] if met else ZERO
        if abs_grad_2d.size > 0:
            for lane in range(count):
                abs_grad_2d[2 * (i + lane)] = sums[lane * SLOT + layout.ABS_X]
                abs_grad_2d[2 * (i + lane) + 1] = sums[lane * SLOT + layout.ABS_Y]


@cached
@njit(parallel=PRANGE, error_model="numpy")
def project_backward(inputs, rest, degree, geometry, view, records, intersections, outputs):
    """Reduce the intersections' gradients to Gaussians and on to the parameters.

    inputs: as in `project`, margin empty. intersections: gradients, how many floats each has, and offsets and places of
    `fill_tiles`. outputs: the gradients of the six parameters, of blur and of the radius by which lens points move a
    Gaussian, grad_2d and abs_grad_2d, all flat; that of blur is empty if blur is empty; the last three may be empty.
    For the radius's, the intersections hold S_POINT_XX … instead of sums of depth (cpu_layout).
    """
    blocks = (inputs[3].size + LANES - 1) // LANES
    chunks = min(blocks, CHUNKS)
    tails = tails_of(inputs, inputs[3].size)
    for chunk in prange(chunks):
        first, stop = chunk * blocks // chunks, (chunk + 1) * blocks // chunks
        backward_blocks(inputs, rest, tails, degree, geometry, view, records, intersections, first, stop, outputs)
