"""Triton kernels of the sweep: sums down the windows' columns, then along them, and the correlation.

A source is warped once for each plane, by programs that walk down a strip of columns and remember the rows under the
window. Their sums go through memory, as the sums along a row need those of other columns.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import op

FLOOR = tl.constexpr(op.FLOOR)
UNKNOWN = tl.constexpr(op.UNKNOWN)


@triton.jit
def _elements(homography):
    """The nine numbers of a 3 x 3 matrix, row by row."""
    a, b, c = tl.load(homography), tl.load(homography + 1), tl.load(homography + 2)
    d, e, f = tl.load(homography + 3), tl.load(homography + 4), tl.load(homography + 5)
    g, h, i = tl.load(homography + 6), tl.load(homography + 7), tl.load(homography + 8)
    return a, b, c, d, e, f, g, h, i


@triton.jit
def _project(matrix, x, y):
    """(u, v, w): image coordinates in the source, and the third of the homogeneous ones."""
    a, b, c, d, e, f, g, h, i = matrix
    w = g * x + (h * y + i)
    # Triton's own quotient may be two units in the last place off, which moves samples at a wide image's far side.
    scale = tl.div_rn(1.0, w)
    return (a * x + (b * y + c)) * scale, (d * x + (e * y + f)) * scale, w


@triton.jit
def _clamp(value, most):
    """Between 0 and `most`; 0 where it is not a number."""
    return tl.where(value > 0.0, tl.where(value < most, value, most), 0.0)


@triton.jit
def _bilinear(image, u, v, height, width):
    """Samples of an image at image coordinates, with border pixels repeated outside."""
    x = _clamp(u - 0.5, width - 1.0)
    y = _clamp(v - 0.5, height - 1.0)
    left, top = x.to(tl.int32), y.to(tl.int32)
    x -= left.to(tl.float32)
    y -= top.to(tl.float32)
    right, below = tl.where(left + 1 < width, 1, 0), tl.where(top + 1 < height, width, 0)
    at = image + (top * width + left)
    upper, upper_right = tl.load(at), tl.load(at + right)
    lower, lower_right = tl.load(at + below), tl.load(at + below + right)
    upper += x * (upper_right - upper)
    lower += x * (lower_right - lower)
    return upper + y * (lower - upper)


@triton.jit
def sum_down(
    reference, sources, homographies, sums, height, width, source_count, source_height, source_width,
    RADIUS: tl.constexpr, ROWS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Sums over the 2 RADIUS + 1 pixels of a window's column, of the warped source, its square, and its product with
    the reference.

    reference: (H, W) and sources: (S, h, w), grey around zero. homographies: (D, S, 3, 3). sums: (D, S, 3, H,
    W + 2 RADIUS), whose column k is that of pixel k - RADIUS. Programs: blocks of columns, strips of ROWS rows, planes
    times sources.
    """
    SIDE: tl.constexpr = 2 * RADIUS + 1
    wide = width + 2 * RADIUS
    column = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    first = tl.program_id(1) * ROWS
    layer = tl.program_id(2)
    mine = column < wide
    image = sources + (layer % source_count).to(tl.int64) * (source_height * source_width)
    matrix = _elements(homographies + layer * 9)
    x = (column - RADIUS).to(tl.float32) + 0.5
    own_column = tl.minimum(tl.maximum(column - RADIUS, 0), width - 1)
    to = sums + layer.to(tl.int64) * (3 * height * wide) + column
    zero = tl.zeros((BLOCK,), tl.float32)
    rows = first - RADIUS + tl.zeros((BLOCK,), tl.int32)  # as many as columns, so that masks are made of equal shapes
    # The rows under the window, the uppermost first; they stay in registers, as the sums over them are unrolled.
    warped = (zero,) * SIDE
    owned = (zero,) * SIDE
    for step in range(tl.minimum(ROWS, height - first) + 2 * RADIUS):
        row = rows + step
        u, v, w = _project(matrix, x, row.to(tl.float32) + 0.5)
        own_row = tl.minimum(tl.maximum(row, 0), height - 1)
        warped = warped[1:] + (_bilinear(image, u, v, source_height, source_width),)
        owned = owned[1:] + (tl.load(reference + own_row * width + own_column),)
        plain, square, mixed = zero, zero, zero
        for k in tl.static_range(SIDE):
            plain += warped[k]
            square += warped[k] * warped[k]
            mixed += warped[k] * owned[k]
        row -= RADIUS
        # The first 2 RADIUS rows only fill the window.
        written = mine & (row >= first) & (row < height)
        tl.store(to + row * wide, plain, mask=written)
        tl.store(to + (height + row) * wide, square, mask=written)
        tl.store(to + (2 * height + row) * wide, mixed, mask=written)


@triton.jit
def correlate(
    sums, homographies, mean, deviation, scores, plane_count, height, width, source_count, source_height, source_width,
    RADIUS: tl.constexpr, BEST: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """The mean of the BEST largest correlations among the sources that see a pixel.

    sums, homographies: see `sum_down`. mean, deviation: (H, W), of the reference under the window. scores: (H, W, D),
    of which the first planes are written. Programs: blocks of pixels, planes.
    """
    SIDE: tl.constexpr = 2 * RADIUS + 1
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    plane = tl.program_id(1)
    inside = at < height * width
    row, column = at // width, at % width
    x, y = column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5
    wide = width + 2 * RADIUS
    size = height * wide
    own = tl.load(mean + at, mask=inside, other=0.0)
    own_deviation = tl.load(deviation + at, mask=inside, other=1.0)
    share = 1.0 / (SIDE * SIDE)
    largest = (tl.full((BLOCK,), float("-inf"), tl.float32),) * BEST
    for source in range(source_count):
        layer = plane * source_count + source
        u, v, w = _project(_elements(homographies + layer * 9), x, y)
        seen = (w > 0.0) & (u >= 0.0) & (u < source_width) & (v >= 0.0) & (v < source_height)
        come = sums + layer.to(tl.int64) * (3 * size) + (row * wide + column)
        plain = tl.zeros((BLOCK,), tl.float32)
        square = tl.zeros((BLOCK,), tl.float32)
        mixed = tl.zeros((BLOCK,), tl.float32)
        for k in tl.static_range(SIDE):
            plain += tl.load(come + k, mask=inside, other=0.0)
            square += tl.load(come + size + k, mask=inside, other=0.0)
            mixed += tl.load(come + 2 * size + k, mask=inside, other=0.0)
        plain *= share
        variance = tl.maximum(square * share - plain * plain, 0.0) + FLOOR
        score = (mixed * share - own * plain) / (own_deviation * tl.sqrt(variance))
        score = tl.where(seen, score, float("-inf"))
        # Insert it into the list, the largest first: each place is visited and moved to the end of the list, and
        # what doesn't fit there goes on to the next.
        for _ in tl.static_range(BEST):
            better = score > largest[0]
            kept = tl.where(better, score, largest[0])
            score = tl.where(better, largest[0], score)
            largest = largest[1:] + (kept,)
    total = tl.zeros((BLOCK,), tl.float32)
    count = tl.zeros((BLOCK,), tl.float32)
    for k in tl.static_range(BEST):
        found = largest[k] > float("-inf")
        total += tl.where(found, largest[k], 0.0)
        count += tl.where(found, 1.0, 0.0)
    score = tl.where(count > 0.0, total / tl.maximum(count, 1.0), UNKNOWN)
    tl.store(scores + at.to(tl.int64) * plane_count + plane, score, mask=inside)
