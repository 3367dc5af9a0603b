"""Triton kernels of the scatter's linear form that both ways share: sums over windows of a row, and where all pairs of
a tile and a window have one weight (the idea is in gpu_linear.py).

A window is FINE or COARSE neighbouring columns of a row. COARSE is a multiple of FINE, a tile's width one of COARSE.
"""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_rim import FOCUS_EXPONENT, STOP_OPACITY, band_of, factor_of, range_of


@triton.jit
def add_windows(
    values, sums, farthest, linear_from, width, columns,
    STEP: tl.constexpr, COUNT: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Sums of COUNT values of a row, STEP columns apart. values: (rows, width); sums: (rows, columns), whose first
    column is STEP (COUNT - 1) columns before that of values. farthest: the largest reach of all tiles; below
    linear_from, the sums aren't needed."""
    if tl.load(farthest) < linear_from:
        return
    row = tl.program_id(0)
    at = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    total = tl.zeros((BLOCK,), tl.float32)
    for step in tl.static_range(COUNT):
        column = at + STEP * (step + 1 - COUNT)
        total += tl.load(values + row * width + column, mask=(column >= 0) & (column < width), other=0.0)
    tl.store(sums + row * columns + at, total, mask=at < columns)


@triton.jit
def chunk_bounds(
    image, signed_radius, brightness, chunks, farthest, linear_from, width, columns, alpha, stop, shortest, obstruction,
    largest_radius, FINE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Bounds of `range_of` for every FINE sources of a row: chunks, (4, rows, columns), least near and hole_near,
    largest far and hole_far."""
    if tl.load(farthest) < linear_from:
        return
    row, rows = tl.program_id(0), tl.num_programs(0)
    chunk = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    x = chunk[:, None] * FINE + tl.arange(0, FINE)[None, :]
    inside = x < width
    at = row * width + x
    radius = tl.abs(tl.load(signed_radius + at, mask=inside, other=0.0))
    peak = tl.zeros((BLOCK, FINE), tl.float32)
    for channel in tl.static_range(3):
        peak = tl.maximum(peak, tl.abs(tl.load(image + at * 3 + channel, mask=inside, other=0.0)))
    band = band_of(peak, brightness, rows * width, stop) / (2.0 * alpha)
    least = (FOCUS_EXPONENT + stop) / (2.0 * alpha)
    near, far, hole_near, hole_far = range_of(radius, band, least, shortest, obstruction, inside, largest_radius)
    to, size = chunks + row * columns + chunk, rows * columns
    tl.store(to, tl.min(near, 1), mask=chunk < columns)
    tl.store(to + size, tl.max(far, 1), mask=chunk < columns)
    tl.store(to + 2 * size, tl.min(hole_near, 1), mask=chunk < columns)
    tl.store(to + 3 * size, tl.max(hole_far, 1), mask=chunk < columns)


@triton.jit
def region_bounds(
    chunks, bounds, farthest, linear_from, height, chunk_columns, columns, FIRST: tl.constexpr, STEP: tl.constexpr,
    COUNT: tl.constexpr, TILE_Y: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """The same for all sources that a tile sees through a window: bounds, (4, rows, columns). Row r is that of sources
    r - TILE_Y + 1 to r, column c that of chunks STEP c + FIRST and the COUNT - 1 after it. Outside of the image there
    is nobody whom a bound would have to hold for."""
    if tl.load(farthest) < linear_from:
        return
    row, rows = tl.program_id(0), tl.num_programs(0)
    column = tl.program_id(1) * BLOCK + tl.arange(0, BLOCK)
    near = tl.full((BLOCK,), float("inf"), tl.float32)
    hole_near = tl.full((BLOCK,), float("inf"), tl.float32)
    far = tl.full((BLOCK,), -float("inf"), tl.float32)
    hole_far = tl.full((BLOCK,), -float("inf"), tl.float32)
    size = height * chunk_columns
    for source in range(tl.maximum(row - (TILE_Y - 1), 0), tl.minimum(row, height - 1) + 1):
        for step in range(COUNT):
            chunk = column * STEP + (FIRST + step)
            there = (chunk >= 0) & (chunk < chunk_columns)
            at = chunks + source * chunk_columns + chunk
            near = tl.minimum(near, tl.load(at, mask=there, other=float("inf")))
            far = tl.maximum(far, tl.load(at + size, mask=there, other=-float("inf")))
            hole_near = tl.minimum(hole_near, tl.load(at + 2 * size, mask=there, other=float("inf")))
            hole_far = tl.maximum(hole_far, tl.load(at + 3 * size, mask=there, other=-float("inf")))
    to, size = bounds + row * columns + column, rows * columns
    tl.store(to, near, mask=column < columns)
    tl.store(to + size, far, mask=column < columns)
    tl.store(to + 2 * size, hole_near, mask=column < columns)
    tl.store(to + 3 * size, hole_far, mask=column < columns)


@triton.jit
def radii_through(first, dy, factors, steepest, height, width, SHAPED: tl.constexpr, WIDE: tl.constexpr):
    """(least, most): bounds of the radius, along a corner, of a source whose rim passes through one of the offsets
    (first, dy) to (first + WIDE - 1, dy), seen from the source.

    steepest: how fast that radius can change with the offset: 1 over the polygon's radius towards an edge's middle.
    """
    # A tensor, as loop counters are Python's own numbers when kernels are interpreted.
    zero = tl.full((), 0.0, tl.float32)
    last = first + (WIDE - 1)
    if SHAPED:
        begin = tl.sqrt(zero + (first * first + dy * dy)) / factor_of(factors, first, dy, height, width)
        end = tl.sqrt(zero + (last * last + dy * dy)) / factor_of(factors, last, dy, height, width)
        slack = 0.5 * (WIDE - 1) * steepest
        return 0.5 * (begin + end) - slack, 0.5 * (begin + end) + slack
    nearest = tl.maximum(tl.maximum(zero + first, zero - last), 0.0)
    farthest = tl.maximum(zero + last, zero - first)
    return tl.sqrt(nearest * nearest + dy * dy), tl.sqrt(farthest * farthest + dy * dy)


@triton.jit
def common_weight(least, most, near, hole_near, hole_far, STOPPED: tl.constexpr):
    """The weight of all pairs whose offsets have radii from least to most, of sources within these bounds; below 0
    where they may differ."""
    if STOPPED:
        return tl.where(
            most <= hole_near, 1.0 - STOP_OPACITY, tl.where((most <= near) & (least >= hole_far), 1.0, -1.0)
        )
    return tl.where(most <= near, 1.0, -1.0)


@triton.jit
def bounds_through(bounds, row, column, rows, columns):
    """(near, far, hole_near, hole_far) from `region_bounds`."""
    at = bounds + row * columns + column
    size = rows * columns
    return tl.load(at), tl.load(at + size), tl.load(at + 2 * size), tl.load(at + 3 * size)


@triton.jit
def sums_through(sums, row, first, height, width, WIDE: tl.constexpr):
    """Four sums over a window from column `first` on, of `add_windows`; 0 outside of the image."""
    columns = width + (WIDE - 1)
    there = (row >= 0) & (row < height) & (first > -WIDE) & (first < width)
    at = sums + row * columns + first + (WIDE - 1)
    size = height * columns
    return (
        tl.load(at, mask=there, other=0.0),
        tl.load(at + size, mask=there, other=0.0),
        tl.load(at + 2 * size, mask=there, other=0.0),
        tl.load(at + 3 * size, mask=there, other=0.0),
    )
