"""Triton kernels of the density: a program for a block of points or samples, whichever ray they belong to."""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_stencil import density_feature, places_of, three_of


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
    """(S,) each sample's density times its length, and the derivative by the sum of its channels."""
    s = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = s < size
    t = tl.load(places + s, mask=inside, other=0.0)
    x, y, z = places_of(origins, directions, tl.load(ray_of + s, mask=inside, other=0), t, inside)
    value, slope = softplus(density_feature(flat, x, y, z, nx, ny, nz, inside, RANK, CHANNELS, BLOCK) + shift)
    length = tl.load(lengths + s, mask=inside, other=0.0)
    tl.store(optical + s, value * length, mask=inside)
    tl.store(slopes + s, slope * length, mask=inside)
