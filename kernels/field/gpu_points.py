"""Triton kernels of what points and directions have by themselves, whichever ray they belong to: density, planes times
lines and their gradient, and the spherical harmonics that a colour depends on."""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_stencil import columns_of, density_feature, line_of, places_of, product, rows_around, rows_of, three_of


@triton.jit
def softplus(x):
    """log(1 + exp(x)), and its derivative.

    log(1 + e) by the series 2 (q + q**3 / 3 + q**5 / 5 + ...) with q = e / (2 + e), at most 1/3, which keeps the digits
    of a small e.
    """
    e = tl.exp(-tl.abs(x))
    q = e / (2.0 + e)
    square = q * q
    series = 1.0 / 11.0 + square * (1.0 / 13.0 + square * (1.0 / 15.0))
    series = 1.0 / 5.0 + square * (1.0 / 7.0 + square * (1.0 / 9.0 + square * series))
    excess = 2.0 * q * (1.0 + square * (1.0 / 3.0 + square * series))
    value = tl.where(x > 0.0, x, 0.0) + excess
    return value, tl.where(x < 0.0, e, 1.0) / (1.0 + e)


@triton.jit(do_not_specialize=["size"])
def densities(
    flat, points, found, size, nx, ny, nz, shift,
    RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """(P,) density at points (P, 3)."""
    p = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = p < size
    x, y, z = three_of(points, p, inside)
    value, _ = softplus(density_feature(flat, x, y, z, nx, ny, nz, inside, RANK, CHANNELS, BLOCK) + shift)
    tl.store(found + p, value, mask=inside)


@triton.jit(do_not_specialize=["size"])
def optical_depths(
    flat, origins, directions, ray_of, places, lengths, optical, slopes, size, nx, ny, nz, shift,
    RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """(S,) each sample's density times its length, and the derivative with respect to the sum of its channels."""
    s = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = s < size
    t = tl.load(places + s, mask=inside, other=0.0)
    x, y, z = places_of(origins, directions, tl.load(ray_of + s, mask=inside, other=0), t, inside)
    value, slope = softplus(density_feature(flat, x, y, z, nx, ny, nz, inside, RANK, CHANNELS, BLOCK) + shift)
    length = tl.load(lengths + s, mask=inside, other=0.0)
    tl.store(optical + s, value * length, mask=inside)
    tl.store(slopes + s, slope * length, mask=inside)


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
    """by_planes, by_lines: (P, 3, RANK), the gradients with respect to a point's interpolated planes and lines, for
    gpu_nodes to add up. gradient: (P, total), of which the columns from `first` on count."""
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


@triton.jit(do_not_specialize=["size"])
def harmonics(views, terms, size, COUNT: tl.constexpr, BLOCK: tl.constexpr):
    """terms: (R, COUNT), as in `reference.harmonics`."""
    ray = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = ray < size
    x, y, z = three_of(views, ray, inside)
    to = terms + ray * COUNT
    tl.store(to, tl.full((BLOCK,), 0.28209479177387814, tl.float32), mask=inside)
    if COUNT > 1:
        tl.store(to + 1, 0.4886025119029199 * y, mask=inside)
        tl.store(to + 2, 0.4886025119029199 * z, mask=inside)
        tl.store(to + 3, 0.4886025119029199 * x, mask=inside)
    if COUNT > 4:
        tl.store(to + 4, 1.0925484305920792 * x * y, mask=inside)
        tl.store(to + 5, 1.0925484305920792 * y * z, mask=inside)
        tl.store(to + 6, 0.31539156525252005 * (2.0 * z * z - x * x - y * y), mask=inside)
        tl.store(to + 7, 1.0925484305920792 * x * z, mask=inside)
        tl.store(to + 8, 0.5462742152960396 * (x * x - y * y), mask=inside)


@triton.jit(do_not_specialize=["size"])
def harmonics_backward(views, by_terms, by_views, size, COUNT: tl.constexpr, BLOCK: tl.constexpr):
    """by_views: (R, 3), from the gradient with respect to the terms."""
    ray = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = ray < size
    by_x, by_y, by_z = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    come = by_terms + ray * COUNT
    if COUNT > 1:
        by_x += 0.4886025119029199 * tl.load(come + 3, mask=inside, other=0.0)
        by_y += 0.4886025119029199 * tl.load(come + 1, mask=inside, other=0.0)
        by_z += 0.4886025119029199 * tl.load(come + 2, mask=inside, other=0.0)
    if COUNT > 4:
        x, y, z = three_of(views, ray, inside)
        xy, yz = tl.load(come + 4, mask=inside, other=0.0), tl.load(come + 5, mask=inside, other=0.0)
        xz, squares = tl.load(come + 7, mask=inside, other=0.0), tl.load(come + 8, mask=inside, other=0.0)
        zonal = 0.6307831305050401 * tl.load(come + 6, mask=inside, other=0.0)
        by_x += 1.0925484305920792 * (y * xy + z * xz + x * squares) - zonal * x
        by_y += 1.0925484305920792 * (x * xy + z * yz - y * squares) - zonal * y
        by_z += 1.0925484305920792 * (y * yz + x * xz) + 2.0 * zonal * z
    tl.store(by_views + 3 * ray, by_x, mask=inside)
    tl.store(by_views + 3 * ray + 1, by_y, mask=inside)
    tl.store(by_views + 3 * ray + 2, by_z, mask=inside)
