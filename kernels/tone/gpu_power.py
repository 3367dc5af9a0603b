"""Triton kernels of the tone curve: one program for each block of numbers. Bound by the memory's bandwidth."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def power(values, result, size, exponent, toe, slope, BLOCK: tl.constexpr):
    """`reference.tone` of `size` numbers."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    x = tl.load(values + at, mask=inside, other=1.0)
    # Comparisons with NaN are false, so NaN takes the line's branch and stays NaN.
    curve = tl.exp2(exponent * tl.log2(tl.maximum(x, toe)))
    tl.store(result + at, tl.where(x >= toe, curve, x * slope), mask=inside)


@triton.jit
def power_gradient(gradient, values, powers, result, size, exponent, toe, slope, BLOCK: tl.constexpr):
    """Its gradient with respect to the numbers; powers: what it gave."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    upstream = tl.load(gradient + at, mask=inside, other=0.0)
    x = tl.load(values + at, mask=inside, other=1.0)
    y = tl.load(powers + at, mask=inside, other=1.0)
    tl.store(result + at, upstream * tl.where(x >= toe, exponent * y / x, slope), mask=inside)
