"""Triton kernels that find where rays meet occupied cells: a program for each ray."""

from __future__ import annotations

import triton
import triton.language as tl

FAR_TOO_MANY = tl.constexpr(1 << 40)


@triton.jit
def cell_of(coordinate, cells):
    """The number of the cell that a coordinate lies in; outside [0, 1] as on the border."""
    inside = tl.minimum(tl.where(coordinate > 0.0, coordinate, 0.0), 1.0)
    return tl.minimum((inside * cells).to(tl.int32), cells - 1)


@triton.jit(do_not_specialize=["count"])
def mark(
    origins, directions, spans, offsets, occupied, marks, counts, count, width, height, depth, BLOCK: tl.constexpr
):  # fmt: skip
    """marks: (R, count), 1 for the steps that are samples. counts: (R,), how many those are; `FAR_TOO_MANY` for a ray
    that isn't finite, so that the sum reports it."""
    ray = tl.program_id(0)
    begin, stop = tl.load(spans + 2 * ray), tl.load(spans + 2 * ray + 1)
    offset = tl.load(offsets + ray)
    ox, oy, oz = tl.load(origins + 3 * ray), tl.load(origins + 3 * ray + 1), tl.load(origins + 3 * ray + 2)
    dx, dy, dz = tl.load(directions + 3 * ray), tl.load(directions + 3 * ray + 1), tl.load(directions + 3 * ray + 2)
    step = (stop - begin) / count
    found = tl.zeros((BLOCK,), tl.int32)
    for first in range(0, count, BLOCK):
        k = first + tl.arange(0, BLOCK)
        place = begin + (k.to(tl.float32) + offset) * step
        x, y, z = cell_of(ox + place * dx, width), cell_of(oy + place * dy, height), cell_of(oz + place * dz, depth)
        some = tl.where(k < count, step, 0.0) > 0.0
        taken = tl.load(occupied + (z * height + y) * width + x, mask=some, other=0).to(tl.int32)
        tl.store(marks + ray * count + k, taken.to(tl.uint8), mask=k < count)
        found += taken
    total = tl.sum(found, 0).to(tl.int64)
    nothing = 0.0 * ox + 0.0 * oy + 0.0 * oz + 0.0 * dx + 0.0 * dy + 0.0 * dz + 0.0 * begin + 0.0 * stop
    tl.store(counts + ray, tl.where(nothing == 0.0, total, FAR_TOO_MANY))


@triton.jit(do_not_specialize=["count"])
def fill(spans, offsets, marks, starts, places, steps, count, BLOCK: tl.constexpr):
    """places and steps of the marked steps, ray after ray."""
    ray = tl.program_id(0)
    begin, stop = tl.load(spans + 2 * ray), tl.load(spans + 2 * ray + 1)
    offset, to = tl.load(offsets + ray), tl.load(starts + ray)
    step = (stop - begin) / count
    for first in range(0, count, BLOCK):
        k = first + tl.arange(0, BLOCK)
        taken = tl.load(marks + ray * count + k, mask=k < count, other=0).to(tl.int32)
        number = tl.cumsum(taken, 0)
        at = to + number - 1
        tl.store(places + at, begin + (k.to(tl.float32) + offset) * step, mask=taken == 1)
        tl.store(steps + at, tl.zeros((BLOCK,), tl.float32) + step, mask=taken == 1)
        to += tl.max(number, 0)
