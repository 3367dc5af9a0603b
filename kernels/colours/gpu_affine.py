"""Triton kernels of the colour transform: one program for each block of pixels. Bound by the memory's bandwidth."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def _colour(image, at, inside):
    """A pixel's three channels; 0 outside."""
    red = tl.load(image + 3 * at, mask=inside, other=0.0)
    green = tl.load(image + 3 * at + 1, mask=inside, other=0.0)
    return red, green, tl.load(image + 3 * at + 2, mask=inside, other=0.0)


@triton.jit
def changed(image, change, result, pixels, BLOCK: tl.constexpr):
    """`reference.colours`."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < pixels
    colour = _colour(image, at, inside)
    for row in tl.static_range(3):
        weights = change + 4 * row
        mixed = tl.load(weights) * colour[0] + tl.load(weights + 1) * colour[1] + tl.load(weights + 2) * colour[2]
        tl.store(result + 3 * at + row, colour[row] + mixed + tl.load(weights + 3), mask=inside)


@triton.jit
def gradient(upstream, image, change, result, sums, pixels, BLOCK: tl.constexpr):
    """By the image; and of each program the sums, (3, 4), of what the transform gets."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < pixels
    colour = _colour(image, at, inside)
    slope = _colour(upstream, at, inside)
    mine = sums + 12 * tl.program_id(0)
    for row in tl.static_range(3):
        weights = change + row
        mixed = tl.load(weights) * slope[0] + tl.load(weights + 4) * slope[1] + tl.load(weights + 8) * slope[2]
        tl.store(result + 3 * at + row, slope[row] + mixed, mask=inside)
        for column in tl.static_range(3):
            tl.store(mine + 4 * row + column, tl.sum(slope[row] * colour[column], 0))
        tl.store(mine + 4 * row + 3, tl.sum(slope[row], 0))
