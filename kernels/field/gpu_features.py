"""Triton kernels of `field_features`: what planes times lines give at points, and its gradient by planes and lines."""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_stencil import columns_of, line_of, product, rows_around, rows_of, three_of


@triton.jit(do_not_specialize=["size", "first", "total"])
def products(
    flat, points, found, size, nx, ny, nz, first, total,
    RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """found: (P, total), its columns from `first` on: a program for a block of points, a mode and a group of
    channels."""
    p = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = p < size
    mode = tl.program_id(1) // (RANK // CHANNELS)
    channel = (tl.program_id(1) % (RANK // CHANNELS) * CHANNELS + tl.arange(0, CHANNELS))[None, :]
    x, y, z = three_of(points, p, inside)
    value = product(flat, x, y, z, mode, nx, ny, nz, channel, inside, RANK)
    to = found + p.to(tl.int64)[:, None] * total + first + mode * RANK + channel
    tl.store(to, value, mask=inside[:, None])


@triton.jit(do_not_specialize=["size", "first", "total"])
def spread_products(
    flat, points, gradient, by_planes, by_lines, size, nx, ny, nz, first, total,
    RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """by_planes, by_lines: (P, 3, RANK), the gradients by a point's interpolated planes and lines, for gpu_nodes to add
    up. gradient: (P, total), of which the columns from `first` on count."""
    p = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = p < size
    mode = tl.program_id(1) // (RANK // CHANNELS)
    channel = (tl.program_id(1) % (RANK // CHANNELS) * CHANNELS + tl.arange(0, CHANNELS))[None, :]
    x, y, z = three_of(points, p, inside)
    across, down, along = columns_of(mode, x, y, z), rows_of(mode, x, y, z), line_of(mode, x, y, z)
    a, b, c, d, e, f, u, v, w = rows_around(flat, across, down, along, mode, nx, ny, nz, channel, inside, RANK)
    upper, lower = a + (b - a) * u, c + (d - c) * u
    number, some = p.to(tl.int64)[:, None], inside[:, None]
    come = tl.load(gradient + number * total + first + mode * RANK + channel, mask=some, other=0.0)
    to = (number * 3 + mode) * RANK + channel
    tl.store(by_planes + to, come * (e + (f - e) * w), mask=some)
    tl.store(by_lines + to, come * (upper + (lower - upper) * v), mask=some)
