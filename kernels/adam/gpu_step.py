"""Triton kernel of Adam's step."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit(do_not_specialize=["size"])
def update(
    values, gradient, first, second, unless, size, keep, add, keep_squares, add_squares, rate, root_share, epsilon,
    WATCHED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Change values, and the means of the gradient and of its square, unless WATCHED and the scalar `unless` is 1.

    keep, add: shares of the mean and of the gradient, keep_squares, add_squares of the squares. rate: that of the step,
    and root_share the factor on the root of the second mean, both with the correction for the means' start at 0.
    """
    if WATCHED:
        size = tl.where(tl.load(unless) == 1.0, 0, size)
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    slope = tl.load(gradient + at, mask=inside, other=0.0)
    mean = keep * tl.load(first + at, mask=inside, other=0.0) + add * slope
    squares = keep_squares * tl.load(second + at, mask=inside, other=0.0) + add_squares * slope * slope
    tl.store(first + at, mean, mask=inside)
    tl.store(second + at, squares, mask=inside)
    changed = tl.load(values + at, mask=inside, other=0.0) - rate * mean / (tl.sqrt(squares) * root_share + epsilon)
    tl.store(values + at, changed, mask=inside)
