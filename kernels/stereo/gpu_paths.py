"""Triton kernels of semiglobal matching: the costs along paths, and the choice of a plane.

The costs of all planes of a pixel are one block in the registers of a warp (of several for more than 128 planes), so
that threads exchange the least cost and those of neighbouring planes without barriers between the steps of a path.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import op

FAR = tl.constexpr(op.FAR)


@triton.jit
def add_path(
    scores, guide, total, plane_count, length, start, line_step, pixel_step, small, large, edge,
    FIRST: tl.constexpr, PLANES: tl.constexpr,
):  # fmt: skip
    """Costs along parallel paths, stored in total where FIRST, else added to it.

    scores, total: (H, W, D). guide: (H, W). A program's path begins at the pixel start + line_step * program and goes
    on by pixel_step, for `length` pixels.
    """
    plane = tl.arange(0, PLANES)
    there = plane < plane_count
    infinity = float("inf")
    # The first plane and the last are their own neighbours, which changes nothing: staying there costs less.
    before, after = tl.maximum(plane - 1, 0), tl.minimum(plane + 1, PLANES - 1)
    pixel = start + tl.program_id(0) * line_step
    last = pixel + (length - 1) * pixel_step
    # Planes beyond the last one cost infinitely much, so that no path goes through them.
    cost = tl.where(there, 0.0, infinity)
    own = tl.load((scores + pixel.to(tl.int64) * plane_count) + plane, mask=there, other=-infinity)
    grey = tl.load(guide + pixel)
    # How far a pixel is from the one before it is carried along, not that pixel's grey: see tests/gpu/test_loops.py.
    contrast = 0.0
    for _ in range(length):
        neighbour = tl.minimum(tl.gather(cost, before, 0), tl.gather(cost, after, 0))
        way = tl.minimum(neighbour + small, cost)
        # What the next pixel needs is read before this one is done, since a step waits for the one before it anyway.
        following = tl.where(pixel == last, pixel, pixel + pixel_step)
        next_own = tl.load((scores + following.to(tl.int64) * plane_count) + plane, mask=there, other=-infinity)
        next_grey = tl.load(guide + following)
        to = (total + pixel.to(tl.int64) * plane_count) + plane
        if not FIRST:
            others = tl.load(to, mask=there)
        lowest = tl.min(cost, 0)
        jump = tl.maximum(large / (1.0 + contrast / edge), small)
        cost = (tl.minimum(way, lowest + jump) - lowest) - own
        if FIRST:
            tl.store(to, cost, mask=there)
        else:
            tl.store(to, others + cost, mask=there)
        contrast = tl.abs(next_grey - grey)
        pixel, own, grey = following, next_own, next_grey


@triton.jit
def choose(total, scores, plane, score, margin, size, plane_count, PIXELS: tl.constexpr, PLANES: tl.constexpr):
    """The plane of least cost, refined by a parabola, its score, and how much more the best plane at a distance costs.

    total, scores: (H, W, D). plane, score, margin: (H, W). size: H W.
    """
    pixel = tl.program_id(0) * PIXELS + tl.arange(0, PIXELS)
    inside = pixel < size
    k = tl.arange(0, PLANES)[None, :]
    first = pixel.to(tl.int64) * plane_count
    infinity = float("inf")
    costs = tl.load(total + first[:, None] + k, mask=inside[:, None] & (k < plane_count), other=0.0)
    costs = tl.where(k < plane_count, costs, infinity)
    least = tl.min(costs, 1)
    # The first of equals; the last plane where all costs aren't numbers, so that only the pixel's own scores are read.
    winner = tl.min(tl.where(costs == least[:, None], k, plane_count - 1), 1)
    second = tl.min(tl.where(tl.abs(k - winner[:, None]) <= FAR, infinity, costs), 1)
    between = inside & (winner > 0) & (winner < plane_count - 1)
    left = tl.load(total + first + winner - 1, mask=between, other=0.0)
    right = tl.load(total + first + winner + 1, mask=between, other=0.0)
    curvature = left - 2.0 * least + right
    curved = between & (curvature > 0.0)
    shift = tl.where(curved, 0.5 * (left - right) / tl.where(curved, curvature, 1.0), 0.0)
    shift = tl.minimum(tl.maximum(shift, -0.5), 0.5)
    tl.store(plane + pixel, winner.to(tl.float32) + shift, mask=inside)
    tl.store(score + pixel, tl.load(scores + first + winner, mask=inside, other=0.0), mask=inside)
    tl.store(margin + pixel, (second - least) * 0.25, mask=inside)
