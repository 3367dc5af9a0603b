"""Triton kernel of Adam's step."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit(do_not_specialize=["tensors"])
def update(
    table, numbers, found_inf, tensors, beta1, rest1, beta2, rest2, eps,
    FINITE: tl.constexpr, WATCHED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Update all tensors unless WATCHED and the scalar `found_inf` is 1. A program has a block of one tensor. FINITE:
    a gradient that isn't finite counts as 0.

    table: (tensors, 8) int64, for each tensor the addresses of parameter, gradient and both averages; its first block;
    its size; first and number of the elements with a gradient, as first << 32 | number; and two float32, seen through
    `numbers`: the learning rate, and the factor on the root of the second average, both with Adam's bias correction.
    """
    block = tl.program_id(0)
    own = 0
    for k in range(1, tensors):
        own += (block >= tl.load(table + 8 * k + 4)).to(tl.int32)
    row = table + 8 * own
    param = tl.load(row).to(tl.pointer_type(tl.float32))
    grad = tl.load(row + 1).to(tl.pointer_type(tl.float32))
    exp_avg = tl.load(row + 2).to(tl.pointer_type(tl.float32))
    exp_avg_sq = tl.load(row + 3).to(tl.pointer_type(tl.float32))
    block -= tl.load(row + 4).to(tl.int32)
    size, given = tl.load(row + 5).to(tl.int32), tl.load(row + 6)
    begin, count = (given >> 32).to(tl.int32), given.to(tl.int32)
    lr, root_factor = tl.load(numbers + 16 * own + 14), tl.load(numbers + 16 * own + 15)
    if WATCHED:
        size = tl.where(tl.load(found_inf) == 1.0, 0, size)
    at = block * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    slope = tl.load(grad + (at - begin), mask=inside & (at >= begin) & (at < begin + count), other=0.0)
    if FINITE:
        slope = tl.where(tl.abs(slope) < float("inf"), slope, 0.0)
    mean = beta1 * tl.load(exp_avg + at, mask=inside, other=0.0) + rest1 * slope
    squares = beta2 * tl.load(exp_avg_sq + at, mask=inside, other=0.0) + rest2 * slope * slope
    tl.store(exp_avg + at, mean, mask=inside)
    tl.store(exp_avg_sq + at, squares, mask=inside)
    changed = tl.load(param + at, mask=inside, other=0.0) - lr * mean / (tl.sqrt(squares) * root_factor + eps)
    tl.store(param + at, changed, mask=inside)
