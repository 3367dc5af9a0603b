"""Triton kernels that mix the scores of a coarser level into those of a finer one, and that project pixels to another
view and back."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def _between(index, size, coarse_size):
    """(plane, share): the coarser plane before a plane, and how far it is from there to the next.

    The first and the last plane of both are the same. Positions are whole numbers, so that none is rounded to another
    plane.
    """
    steps = tl.maximum(size - 1, 1)
    position = index * (coarse_size - 1)
    whole = position // steps
    return whole, (position - whole * steps) / (1.0 * steps)


@triton.jit
def _within(pixel, size, coarse_size):
    """(first, second, share): the coarser pixels whose centres lie around a pixel's centre; pixels are areas."""
    position = tl.maximum((2 * pixel + 1) * coarse_size - size, 0)  # in units of 1 / (2 size)
    first = position // (2 * size)
    share = (position - first * (2 * size)) / (2.0 * size)
    return first, tl.minimum(first + 1, coarse_size - 1), share


@triton.jit
def _mix(one, other, share):
    return one + share * (other - one)


@triton.jit
def _bilinear(upper, lower, left, right, along, down, mask):
    """One plane's score between four coarser pixels. upper, lower: their rows. left, right: places there."""
    above = _mix(tl.load(upper + left, mask=mask), tl.load(upper + right, mask=mask), along)
    below = _mix(tl.load(lower + left, mask=mask), tl.load(lower + right, mask=mask), along)
    return _mix(above, below, down)


@triton.jit
def add_coarse(
    scores, coarse, share, height, width, plane_count, coarse_height, coarse_width, coarse_count, BLOCK: tl.constexpr
):
    """Mix coarse (h, w, d), enlarged, into scores (H, W, D) in place. Programs: blocks of a row's scores, rows."""
    row = tl.program_id(1)
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < width * plane_count
    column, plane = at // plane_count, at % plane_count
    nearer, beyond = _between(plane, plane_count, coarse_count)
    farther = tl.minimum(nearer + 1, coarse_count - 1)
    left, right, along = _within(column, width, coarse_width)
    top, bottom, down = _within(row, height, coarse_height)
    pitch = coarse_width * coarse_count
    upper, lower = coarse + top.to(tl.int64) * pitch, coarse + bottom.to(tl.int64) * pitch
    left, right = left * coarse_count, right * coarse_count
    near = _bilinear(upper, lower, left + nearer, right + nearer, along, down, inside)
    far = _bilinear(upper, lower, left + farther, right + farther, along, down, inside)
    to = scores + row.to(tl.int64) * (width * plane_count) + at
    tl.store(to, _mix(tl.load(to, mask=inside), _mix(near, far, beyond), share), mask=inside)


@triton.jit
def _move(matrix, x, y, z):
    """(u, v, w) of pixels at depth z in the other view, by a (3, 4) matrix; w is the depth there."""
    u = z * (tl.load(matrix) * x + tl.load(matrix + 1) * y + tl.load(matrix + 2)) + tl.load(matrix + 3)
    v = z * (tl.load(matrix + 4) * x + tl.load(matrix + 5) * y + tl.load(matrix + 6)) + tl.load(matrix + 7)
    w = z * (tl.load(matrix + 8) * x + tl.load(matrix + 9) * y + tl.load(matrix + 10)) + tl.load(matrix + 11)
    return u / w, v / w, w


@triton.jit
def find_returns(
    depth, other, there, back, limits, found, height, width, other_height, other_width, BLOCK: tl.constexpr
):
    """Where the other view sees the same surface: found (H, W) of bool. Programs: blocks of pixels.

    limits: (pixels squared, share). there, back and limits are float64.
    """
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < height * width
    z = tl.load(depth + at, mask=inside, other=0.0).to(tl.float64)
    column, row = (at % width).to(tl.float64) + 0.5, (at // width).to(tl.float64) + 0.5
    x, y, w = _move(there, column, row, z)
    seen = (z > 0.0) & (w > 0.0) & (x >= 0.0) & (y >= 0.0) & (x < other_width) & (y < other_height)
    # Coordinates outside may be too large for a whole number.
    hit = tl.where(seen, y, 0.0).to(tl.int32) * other_width + tl.where(seen, x, 0.0).to(tl.int32)
    z_there = tl.load(other + hit, mask=seen, other=0.0).to(tl.float64)
    u, v, again = _move(back, x, y, z_there)
    across, down = u - column, v - row
    near = across * across + down * down < tl.load(limits)
    near = near & (tl.abs(again / z - 1.0) < tl.load(limits + 1))
    tl.store(found + at, seen & (z_there > 0.0) & (again > 0.0) & near, mask=inside)
