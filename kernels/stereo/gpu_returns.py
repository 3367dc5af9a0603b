"""Triton kernel of the check that projects pixels to another view and back, in float64 as on the CPU."""

from __future__ import annotations

import triton
import triton.language as tl


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
