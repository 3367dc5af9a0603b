"""The gradient of projection: the sums over each Gaussian's intersections, and the walk over all Gaussians, eight at a
time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import cached
from dofbench.runtime.simd import LANES, splat8
from dofbench.runtime.simd_memory import load8, prefetch, store8

from . import cpu_layout as layout
from .cpu_blocks import CHUNKS, tail_of, tails_of
from .cpu_footprint import ZERO
from .cpu_gaussian_backward import backward_block
from .cpu_sh import TERMS

SLOT = layout.SLOT


@njit(forceinline=True)
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


@njit(error_model="numpy")
def zero_rows(array, n, i, count):
    """Set rows i … i + count - 1 of a flat array of n rows to zero; the array may be empty."""
    width = array.size // n
    for k in range(width * i, width * (i + count)):
        array[k] = ZERO


@njit(error_model="numpy")
def zero_block(outputs, n, i, count):
    """Write the zero gradients of a block of Gaussians that no tile met."""
    d_means, d_scales, d_quaternions, d_logits, d_dc, d_rest, d_blur, d_radius, grad_2d, abs_grad_2d = outputs
    zero_rows(d_means, n, i, count)
    zero_rows(d_scales, n, i, count)
    zero_rows(d_quaternions, n, i, count)
    zero_rows(d_logits, n, i, count)
    zero_rows(d_dc, n, i, count)
    zero_rows(d_rest, n, i, count)
    zero_rows(d_blur, n, i, count)
    zero_rows(d_radius, n, i, count)
    zero_rows(grad_2d, n, i, count)
    zero_rows(abs_grad_2d, n, i, count)


@njit(error_model="numpy")
def put_tail(array, n, tail):
    """Write a padded block back to the rows after the last full block; the inverse of `tail_of`."""
    start = n // LANES * LANES * (array.size // n)
    for k in range(start, array.size):
        array[k] = tail[k - start]


@njit(error_model="numpy")
def met_lanes(offsets, i, count):
    """Which of the Gaussians i … i + count - 1 met a tile; bit k is Gaussian i + k."""
    bits = 0
    for lane in range(count):
        if offsets[i + lane + 1] > offsets[i + lane]:
            bits |= 1 << lane
    return bits


@njit(error_model="numpy")
def backward_blocks(
    means,
    log_scales,
    quaternions,
    opacity_logits,
    sh_dc,
    sh_rest,
    rest,
    filter_3d,
    blur,
    tails,
    degree,
    geometry,
    view,
    records,
    gradients,
    width,
    offsets,
    places,
    first,
    stop,
    outputs,
):
    """Compute the gradients of the blocks first … stop - 1."""
    n = opacity_logits.size
    d_means, d_scales, d_quaternions, d_logits, d_dc, d_rest, d_blur, d_radius, grad_2d, abs_grad_2d = outputs
    sums = np.empty(LANES * SLOT, np.float32)
    mean_2d = np.empty(2 * LANES, np.float32)
    basis, pulls = np.empty(TERMS * LANES, np.float32), np.empty(TERMS * LANES, np.float32)
    t_means, t_scales, t_quaternions = tail_of(d_means, n), tail_of(d_scales, n), tail_of(d_quaternions, n)
    t_logits, t_dc, t_rest = tail_of(d_logits, n), tail_of(d_dc, n), tail_of(d_rest, n)
    t_blur, t_radius = tail_of(d_blur, n), tail_of(d_radius, n)
    for block in range(first, stop):
        i = block * LANES
        count = min(LANES, n - i)
        seen = met_lanes(offsets, i, count)
        if seen == 0:
            zero_block(outputs, n, i, count)
            continue
        for k in range(sums.size):
            sums[k] = ZERO
        # The next block's intersections are scattered in memory; prefetching them now hides the latency behind this
        # block.
        for k in range(np.int64(offsets[i + count]), np.int64(offsets[min(i + 2 * LANES, n)])):
            prefetch(gradients, np.int64(places[k]) * width)
        for lane in range(count):
            reduce_places(
                gradients, width, places, np.int64(offsets[i + lane]), np.int64(offsets[i + lane + 1]), sums, lane
            )
        # One call with chosen arguments: a second call would be a second copy to compile.
        if count == LANES:
            place, a, b, c, d, e, f, g = i, means, log_scales, quaternions, opacity_logits, sh_rest, filter_3d, blur
            o_a, o_b, o_c, o_d, o_e, o_f, o_g = d_means, d_scales, d_quaternions, d_logits, d_dc, d_rest, d_blur
            o_h = d_radius
        else:
            place, (a, b, c, d, _, e, f, g, _) = 0, tails
            o_a, o_b, o_c, o_d, o_e, o_f, o_g = t_means, t_scales, t_quaternions, t_logits, t_dc, t_rest, t_blur
            o_h = t_radius
        backward_block(
            a,
            b,
            c,
            d,
            e,
            rest,
            f,
            g,
            degree,
            geometry,
            view,
            place,
            records,
            i,
            seen,
            sums,
            o_a,
            o_b,
            o_c,
            o_d,
            o_e,
            o_f,
            o_g,
            o_h,
            mean_2d,
            basis,
            pulls,
        )
        if count < LANES:
            put_tail(d_means, n, t_means)
            put_tail(d_scales, n, t_scales)
            put_tail(d_quaternions, n, t_quaternions)
            put_tail(d_logits, n, t_logits)
            put_tail(d_dc, n, t_dc)
            put_tail(d_rest, n, t_rest)
            put_tail(d_blur, n, t_blur)
            put_tail(d_radius, n, t_radius)
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
@njit(parallel=True, error_model="numpy")
def project_backward(
    means,
    log_scales,
    quaternions,
    opacity_logits,
    sh_dc,
    sh_rest,
    rest,
    filter_3d,
    blur,
    degree,
    geometry,
    view,
    records,
    gradients,
    width,
    offsets,
    places,
    outputs,
):
    """Reduce the intersections' gradients (`width` floats each) to Gaussians and on to the parameters.

    outputs: the gradients of the six inputs, of blur and of the radius by which lens points move a Gaussian, grad_2d
    and abs_grad_2d, all flat; that of blur is empty if blur is empty; the last three may be empty. For the radius's,
    the intersections hold S_POINT_XX … instead of sums of depth (cpu_layout).
    """
    blocks = (opacity_logits.size + LANES - 1) // LANES
    chunks = min(blocks, CHUNKS)
    tails = tails_of(
        means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest, filter_3d, blur, np.empty(0, np.float32)
    )
    for chunk in prange(chunks):
        backward_blocks(
            means,
            log_scales,
            quaternions,
            opacity_logits,
            sh_dc,
            sh_rest,
            rest,
            filter_3d,
            blur,
            tails,
            degree,
            geometry,
            view,
            records,
            gradients,
            width,
            offsets,
            places,
            chunk * blocks // chunks,
            (chunk + 1) * blocks // chunks,
            outputs,
        )
