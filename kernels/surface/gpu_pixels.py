"""Triton kernels of a surface's disparity, its circle of confusion, and the error of rendered depth at samples of known
depth: one program for each block of pixels or samples. Bound by the memory's bandwidth, or by being launched."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def _there(depth, alpha, at, inside, least_alpha):
    """The depth of pixels with a surface, 1 elsewhere; and which have one."""
    z = tl.load(depth + at, mask=inside, other=0.0)
    there = (tl.load(alpha + at, mask=inside, other=0.0) > least_alpha) & (z > 0.0)
    return tl.where(there, z, 1.0), there


@triton.jit
def disparities(depth, alpha, result, farthest, size, least_alpha, BLOCK: tl.constexpr):
    """1 / depth where a surface is, infinity elsewhere; and the least of each program's."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    z, there = _there(depth, alpha, at, inside, least_alpha)
    disparity = tl.where(there, 1.0 / z, float("inf"))
    tl.store(result + at, disparity, mask=inside)
    tl.store(farthest + tl.program_id(0), tl.min(disparity, 0))


@triton.jit
def fill(depth, alpha, farthest, result, size, programs, least_alpha, BLOCK: tl.constexpr):
    """The least of all programs' disparities where no surface is, or 0 if it is infinite."""
    own = tl.arange(0, BLOCK)
    least = tl.full((BLOCK,), float("inf"), tl.float32)
    for first in range(0, programs, BLOCK):
        known = tl.load(farthest + first + own, mask=first + own < programs, other=float("inf"))
        least = tl.minimum(least, known)
    far = tl.min(least, 0)
    at = tl.program_id(0) * BLOCK + own
    inside = at < size
    _, there = _there(depth, alpha, at, inside, least_alpha)
    value = tl.zeros((BLOCK,), tl.float32) + tl.where(far == float("inf"), 0.0, far)
    tl.store(result + at, value, mask=inside & (there == 0))


@triton.jit
def disparities_gradient(gradient, depth, alpha, result, size, least_alpha, BLOCK: tl.constexpr):
    """By depth."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    z, there = _there(depth, alpha, at, inside, least_alpha)
    upstream = tl.load(gradient + at, mask=inside, other=0.0)
    tl.store(result + at, tl.where(there, -upstream / (z * z), 0.0), mask=inside)


@triton.jit
def _clipped(x, least, most):
    # Comparisons with NaN are false, so NaN stays NaN.
    x = tl.where(x < least, least, x)
    return tl.where(x > most, most, x)


@triton.jit
def circles(disparity, slope, offset, result, size, low, extent, scale, least, most, BLOCK: tl.constexpr):
    """`reference.circle`. slope, offset: a number each."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    x = _clipped((tl.load(disparity + at, mask=inside, other=0.0) - low) / extent, least, most)
    tl.store(result + at, scale * (tl.load(slope) * x + tl.load(offset)), mask=inside)


@triton.jit
def circles_gradient(
    gradient, disparity, slope, result, sums, size, low, extent, scale, least, most, BLOCK: tl.constexpr,
):  # fmt: skip
    """By disparity; and of each program the sums of what slope and offset get."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    upstream = scale * tl.load(gradient + at, mask=inside, other=0.0)
    x = (tl.load(disparity + at, mask=inside, other=0.0) - low) / extent
    free = (x >= least) & (x <= most)
    tl.store(result + at, tl.where(free, upstream * (tl.load(slope) / extent), 0.0), mask=inside)
    tl.store(sums + 2 * tl.program_id(0), tl.sum(tl.where(inside, upstream * _clipped(x, least, most), 0.0), 0))
    tl.store(sums + 2 * tl.program_id(0) + 1, tl.sum(upstream, 0))


@triton.jit
def _sample(
    depth, alpha, rows, columns, known, shares, weight, i, inside, width, least_alpha, inverse_extent,
    INVERSE: tl.constexpr, SQUARED: tl.constexpr, SHARED: tl.constexpr, WEIGHTED: tl.constexpr,
):  # fmt: skip
    """Of each sample its pixel, error, its share, and the derivative of the error by the pixel's depth; nothing where
    no surface is."""
    pixel = tl.load(rows + i, mask=inside, other=0) * width + tl.load(columns + i, mask=inside, other=0)
    there = inside & (tl.load(alpha + pixel, mask=inside, other=0.0) > least_alpha)
    z = tl.load(depth + pixel, mask=there, other=1.0)
    truth = tl.load(known + i, mask=there, other=1.0)
    difference = z - truth
    slope = tl.full(z.shape, 1.0, tl.float32)
    if INVERSE:
        difference = (1.0 / z - 1.0 / truth) * inverse_extent
        slope = -inverse_extent / (z * z)
    share = tl.where(there, 1.0, 0.0)
    if SHARED:
        share = tl.load(shares + i, mask=there, other=0.0)
    factor = share
    if WEIGHTED:
        factor = factor * tl.load(weight + pixel, mask=there, other=0.0)
    if SQUARED:
        error = difference * difference
        slope = slope * 2.0 * difference
    else:
        error = tl.abs(difference)
        slope = slope * tl.where(difference > 0.0, 1.0, tl.where(difference < 0.0, -1.0, difference))
    return pixel, tl.where(there, factor * error, 0.0), share, tl.where(there, factor * slope, 0.0)


@triton.jit(do_not_specialize=["count"])
def depth_error(
    depth, alpha, rows, columns, known, shares, weight, sums, count, width, least_alpha, inverse_extent,
    INVERSE: tl.constexpr, SQUARED: tl.constexpr, SHARED: tl.constexpr, WEIGHTED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Of each program the sum of its samples' errors and that of their shares; see `reference.known_depth`."""
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    _, error, share, _ = _sample(
        depth, alpha, rows, columns, known, shares, weight, i, i < count, width, least_alpha, inverse_extent,
        INVERSE, SQUARED, SHARED, WEIGHTED,
    )  # fmt: skip
    tl.store(sums + 2 * tl.program_id(0), tl.sum(error, 0))
    tl.store(sums + 2 * tl.program_id(0) + 1, tl.sum(share, 0))


@triton.jit(do_not_specialize=["count", "most"])
def depth_error_gradient(
    depth, alpha, rows, columns, known, shares, weight, gradient, counted, result, count, width, most, least_alpha,
    inverse_extent, INVERSE: tl.constexpr, SQUARED: tl.constexpr, SHARED: tl.constexpr, WEIGHTED: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """By depth: the first sample of a pixel adds up those of the same pixel, which come next, of at most `most`."""
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = i < count
    own = tl.load(rows + i, mask=inside, other=0) * width + tl.load(columns + i, mask=inside, other=0)
    earlier = inside & (i > 0)
    before = tl.load(rows + i - 1, mask=earlier, other=-1) * width + tl.load(columns + i - 1, mask=earlier, other=0)
    first = inside & (own != before)
    total = tl.zeros((BLOCK,), tl.float32)
    for behind in range(most):
        next_one = i + behind
        there = first & (next_one < count)
        pixel, _, _, slope = _sample(
            depth, alpha, rows, columns, known, shares, weight, next_one, there, width, least_alpha, inverse_extent,
            INVERSE, SQUARED, SHARED, WEIGHTED,
        )  # fmt: skip
        total += tl.where(there & (pixel == own), slope, 0.0)
    tl.store(result + own, total * (tl.load(gradient) / tl.load(counted)), mask=first)
