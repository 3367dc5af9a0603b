"""Triton kernel of Adam's step."""

from __future__ import annotations

import triton
import triton.language as tl

_ANY = [f"{name}{place}" for place in range(6) for name in ("size", "begin", "count")]


@triton.jit(do_not_specialize=_ANY)
def update(
    values0, gradient0, first0, second0, size0, begin0, count0, rate0, root_share0,
    values1, gradient1, first1, second1, size1, begin1, count1, rate1, root_share1,
    values2, gradient2, first2, second2, size2, begin2, count2, rate2, root_share2,
    values3, gradient3, first3, second3, size3, begin3, count3, rate3, root_share3,
    values4, gradient4, first4, second4, size4, begin4, count4, rate4, root_share4,
    values5, gradient5, first5, second5, size5, begin5, count5, rate5, root_share5,
    unless, keep, add, keep_squares, add_squares, epsilon,
    FINITE: tl.constexpr, WATCHED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Change up to six tensors, and the means of their gradients and of these gradients' squares, unless WATCHED and
    the scalar `unless` is 1. A program has a block of one tensor; where there are fewer tensors, sizes are 0. FINITE:
    what isn't finite in a gradient counts as 0.

    begin, count: the numbers that `gradient` has one for. keep, add: shares of the mean and of the gradient,
    keep_squares, add_squares of the squares. rate: that of the step, and root_share the factor on the root of the
    second mean, both with the correction for the means' start at 0.
    """
    block = tl.program_id(0)
    all_values = (values0, values1, values2, values3, values4, values5)
    gradients = (gradient0, gradient1, gradient2, gradient3, gradient4, gradient5)
    firsts = (first0, first1, first2, first3, first4, first5)
    seconds = (second0, second1, second2, second3, second4, second5)
    sizes = (size0, size1, size2, size3, size4, size5)
    begins = (begin0, begin1, begin2, begin3, begin4, begin5)
    counts = (count0, count1, count2, count3, count4, count5)
    rates = (rate0, rate1, rate2, rate3, rate4, rate5)
    root_shares = (root_share0, root_share1, root_share2, root_share3, root_share4, root_share5)
    size, begin, count, rate, root_share = size0, begin0, count0, rate0, root_share0
    values, gradient, first, second = values0, gradient0, first0, second0
    for place in tl.static_range(1, 6):
        blocks = tl.cdiv(size, BLOCK)
        past = block >= blocks
        block = tl.where(past, block - blocks, block)
        values = tl.where(past, all_values[place], values)
        gradient = tl.where(past, gradients[place], gradient)
        first = tl.where(past, firsts[place], first)
        second = tl.where(past, seconds[place], second)
        size = tl.where(past, sizes[place], size)
        begin = tl.where(past, begins[place], begin)
        count = tl.where(past, counts[place], count)
        rate = tl.where(past, rates[place], rate)
        root_share = tl.where(past, root_shares[place], root_share)
    if WATCHED:
        size = tl.where(tl.load(unless) == 1.0, 0, size)
    at = block * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    given = inside & (at >= begin) & (at < begin + count)
    slope = tl.load(gradient + (at - begin), mask=given, other=0.0)
    if FINITE:
        slope = tl.where(tl.abs(slope) < float("inf"), slope, 0.0)
    mean = keep * tl.load(first + at, mask=inside, other=0.0) + add * slope
    squares = keep_squares * tl.load(second + at, mask=inside, other=0.0) + add_squares * slope * slope
    tl.store(first + at, mean, mask=inside)
    tl.store(second + at, squares, mask=inside)
    changed = tl.load(values + at, mask=inside, other=0.0) - rate * mean / (tl.sqrt(squares) * root_share + epsilon)
    tl.store(values + at, changed, mask=inside)
