"""Triton kernel that sums what all intersections of a Gaussian contribute to its gradient, always in the same order."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit(do_not_specialize=["n"])
def sum_slots(
    slots,
    order,
    ends,
    sums,
    n,
    views,
    SLOT: tl.constexpr,
    COLUMNS: tl.constexpr,
    GAUSSIANS: tl.constexpr,
    ROWS: tl.constexpr,
):
    """The sum of each Gaussian's slots, which lie beside each other; a group of Gaussians in each program.

    slots: (intersections, SLOT). order, ends: as in `gpu_tiles.fill`. sums: (N, SLOT). COLUMNS: SLOT rounded up to a
    power of two. ROWS: of a Gaussian's slots that are read at once, so that the sum over a wide Gaussian's thousands of
    intersections doesn't wait for memory that often.
    """
    rank = tl.program_id(0) * GAUSSIANS + tl.arange(0, GAUSSIANS)
    inside = rank < n
    i = tl.load(order + rank, mask=inside, other=0)
    begin = tl.load(ends + rank * views - 1, mask=inside & (rank > 0), other=0)
    many = (tl.load(ends + rank * views + (views - 1), mask=inside, other=0) - begin).to(tl.int32)
    row, column = tl.arange(0, ROWS)[None, :, None], tl.arange(0, COLUMNS)[None, None, :]
    total = tl.zeros((GAUSSIANS, ROWS, COLUMNS), tl.float32)
    for first in range(0, tl.max(many, 0), ROWS):
        inner = (first + row < many[:, None, None]) & (column < SLOT)
        total += tl.load(slots + (begin[:, None, None] + first + row) * SLOT + column, mask=inner, other=0.0)
    where = sums + i[:, None] * SLOT + tl.arange(0, COLUMNS)[None, :]
    tl.store(where, tl.sum(total, 1), mask=inside[:, None] & (tl.arange(0, COLUMNS)[None, :] < SLOT))
