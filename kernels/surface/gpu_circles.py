"""Triton kernels of a surface's disparity and its circle of confusion: one program for each block of pixels. Bound by
the memory's bandwidth, or by being launched."""

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
