"""Triton kernels of the similarity and its gradient: the Gaussian window along rows, then along columns.

The formulae are those of cpu.py: with d = prediction - target the dissimilarity follows from four filtered maps, the
prediction, the target, the sum of their squares and d squared, both images shifted by `centre`. Images are (H, W, C),
read as rows of W C numbers; a map is (H, W C).
"""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def filter_images_along_rows(
    prediction, target, taps, maps, length, channels, centre, RADIUS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Of each row, the four quantities under the window. taps: (2 RADIUS + 1,). maps: (4, H, W C). length: W C."""
    row, at = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    size = tl.num_programs(1) * length
    mean_p = tl.zeros((BLOCK,), tl.float32)
    mean_t = tl.zeros((BLOCK,), tl.float32)
    squares = tl.zeros((BLOCK,), tl.float32)
    errors = tl.zeros((BLOCK,), tl.float32)
    for tap in range(2 * RADIUS + 1):
        column = at + (tap - RADIUS) * channels
        inside = (column >= 0) & (column < length)
        weight = tl.load(taps + tap)
        # Outside the image is nothing: a shifted image is 0 there, and not minus the shift.
        p = tl.load(prediction + row * length + column, mask=inside, other=0.0)
        t = tl.load(target + row * length + column, mask=inside, other=0.0)
        d = p - t
        p = tl.where(inside, p - centre, 0.0)
        t = tl.where(inside, t - centre, 0.0)
        mean_p += weight * p
        mean_t += weight * t
        squares += weight * (p * p + t * t)
        errors += weight * (d * d)
    mine, to = at < length, row * length + at
    tl.store(maps + to, mean_p, mask=mine)
    tl.store(maps + size + to, mean_t, mask=mine)
    tl.store(maps + 2 * size + to, squares, mask=mine)
    tl.store(maps + 3 * size + to, errors, mask=mine)


@triton.jit
def _share(weights, row, column, width, height, mask):
    return tl.load(weights + row * width + column, mask=mask & (row < height) & (column < width), other=0.0)


@triton.jit
def compare(
    prediction, target, weights, taps, frame_y, frame_x, maps, slopes, sums,
    height, length, channels, centre, c1, c2,
    RADIUS: tl.constexpr, WEIGHTED: tl.constexpr, WEIGH_ALL: tl.constexpr, L1: tl.constexpr, EDGES: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Along columns, then everything that is summed up: of each program the sums of weight (1 - S), weight |d|, and the
    steps of d between neighbours in a row and in a column.

    frame_y, frame_x: (2, H), (2, W): the share of the window that lies inside, and whether the pixel counts. slopes:
    (3, H, W C), how (1 - S) of a pixel changes with the mean under its window, with that of d squared, and with that
    of the squares. sums: (programs, 4).
    """
    row, at = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    rows = row + tl.zeros((BLOCK,), tl.int32)  # as many as columns, so that masks are made of equal shapes
    size, mine = height * length, at < length
    mean_p = tl.zeros((BLOCK,), tl.float32)
    mean_t = tl.zeros((BLOCK,), tl.float32)
    squares = tl.zeros((BLOCK,), tl.float32)
    errors = tl.zeros((BLOCK,), tl.float32)
    for tap in range(2 * RADIUS + 1):
        other = rows + tap - RADIUS
        inside = mine & (other >= 0) & (other < height)
        weight, come = tl.load(taps + tap), maps + other * length + at
        mean_p += weight * tl.load(come, mask=inside, other=0.0)
        mean_t += weight * tl.load(come + size, mask=inside, other=0.0)
        squares += weight * tl.load(come + 2 * size, mask=inside, other=0.0)
        errors += weight * tl.load(come + 3 * size, mask=inside, other=0.0)
    width, column = length // channels, at // channels
    share = tl.load(frame_y + row) * tl.load(frame_x + column, mask=mine, other=1.0)
    counts = tl.load(frame_y + height + row) * tl.load(frame_x + width + column, mask=mine, other=0.0)
    # Means and variances of the images as they are, from those of the shifted ones.
    p, t, mean_d = mean_p + centre * share, mean_t + centre * share, mean_p - mean_t
    lean = centre * (1.0 - share)
    b1 = p * p + t * t + c1
    b2 = squares - mean_p * mean_p - mean_t * mean_t + 2.0 * lean * (mean_p + mean_t + centre * share) + c2
    variance_d = errors - mean_d * mean_d
    unlike_luminance, unlike_structure = mean_d * mean_d / b1, variance_d / b2
    luminance, structure = 1.0 - unlike_luminance, 1.0 - unlike_structure
    unlike = unlike_luminance + unlike_structure - unlike_luminance * unlike_structure
    own_weight = tl.full((BLOCK,), 1.0, tl.float32)
    if WEIGHTED:
        own_weight = _share(weights, rows, column, width, height, mine)
    if WEIGH_ALL:
        counts = counts * own_weight
    by_mean = structure * (2.0 * mean_d / b1 - 2.0 * p * mean_d * mean_d / (b1 * b1))
    by_mean += luminance * (2.0 * variance_d / (b2 * b2) * (mean_p - lean) - 2.0 * mean_d / b2)
    to = slopes + row * length + at
    tl.store(to, counts * by_mean, mask=mine)
    tl.store(to + size, counts * luminance / b2, mask=mine)
    tl.store(to + 2 * size, -counts * luminance * variance_d / (b2 * b2), mask=mine)

    program = sums + 4 * (row * tl.num_programs(0) + tl.program_id(0))
    tl.store(program, tl.sum(tl.where(mine, counts * unlike, 0.0), 0))
    if L1 or EDGES:
        here = row * length + at
        d = tl.load(prediction + here, mask=mine, other=0.0) - tl.load(target + here, mask=mine, other=0.0)
        if L1:
            tl.store(program + 1, tl.sum(tl.where(mine, own_weight * tl.abs(d), 0.0), 0))
        if EDGES:
            right, below = mine & (column + 1 < width), mine & (rows + 1 < height)
            step_x = _error(prediction, target, here + channels, right) - d
            step_y = _error(prediction, target, here + length, below) - d
            if WEIGH_ALL:
                step_x = step_x * 0.5 * (own_weight + _share(weights, rows, column + 1, width, height, mine))
                step_y = step_y * 0.5 * (own_weight + _share(weights, rows + 1, column, width, height, mine))
            tl.store(program + 2, tl.sum(tl.where(right, tl.abs(step_x), 0.0), 0))
            tl.store(program + 3, tl.sum(tl.where(below, tl.abs(step_y), 0.0), 0))


@triton.jit
def _error(prediction, target, at, mask):
    return tl.load(prediction + at, mask=mask, other=0.0) - tl.load(target + at, mask=mask, other=0.0)


@triton.jit
def filter_slopes_along_rows(slopes, taps, maps, length, channels, RADIUS: tl.constexpr, BLOCK: tl.constexpr):
    """The three maps of slopes under the window, which is its own transpose."""
    row, at = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    size = tl.num_programs(1) * length
    by_mean = tl.zeros((BLOCK,), tl.float32)
    by_error = tl.zeros((BLOCK,), tl.float32)
    by_square = tl.zeros((BLOCK,), tl.float32)
    for tap in range(2 * RADIUS + 1):
        column = at + (tap - RADIUS) * channels
        inside = (column >= 0) & (column < length)
        weight, come = tl.load(taps + tap), slopes + row * length + column
        by_mean += weight * tl.load(come, mask=inside, other=0.0)
        by_error += weight * tl.load(come + size, mask=inside, other=0.0)
        by_square += weight * tl.load(come + 2 * size, mask=inside, other=0.0)
    mine, to = at < length, maps + row * length + at
    tl.store(to, by_mean, mask=mine)
    tl.store(to + size, by_error, mask=mine)
    tl.store(to + 2 * size, by_square, mask=mine)


@triton.jit
def _sign(value):
    return tl.where(value > 0.0, 1.0, 0.0) - tl.where(value < 0.0, 1.0, 0.0)


@triton.jit
def gradient(
    prediction, target, weights, taps, maps, scales, result, height, length, channels, centre,
    RADIUS: tl.constexpr, WEIGHTED: tl.constexpr, WEIGH_ALL: tl.constexpr, L1: tl.constexpr, EDGES: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """The slopes along columns, and the gradients of the other sums. scales: (4,), what each sum is worth, on the
    device."""
    row, at = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    rows = row + tl.zeros((BLOCK,), tl.int32)  # as many as columns, so that masks are made of equal shapes
    size, mine = height * length, at < length
    by_mean = tl.zeros((BLOCK,), tl.float32)
    by_error = tl.zeros((BLOCK,), tl.float32)
    by_square = tl.zeros((BLOCK,), tl.float32)
    for tap in range(2 * RADIUS + 1):
        other = rows + tap - RADIUS
        inside = mine & (other >= 0) & (other < height)
        weight, come = tl.load(taps + tap), maps + other * length + at
        by_mean += weight * tl.load(come, mask=inside, other=0.0)
        by_error += weight * tl.load(come + size, mask=inside, other=0.0)
        by_square += weight * tl.load(come + 2 * size, mask=inside, other=0.0)
    here, width, column = row * length + at, length // channels, at // channels
    p = tl.load(prediction + here, mask=mine, other=0.0)
    d = p - tl.load(target + here, mask=mine, other=0.0)
    total = tl.load(scales) * (by_mean + 2.0 * d * by_error + 2.0 * (p - centre) * by_square)
    own_weight = tl.full((BLOCK,), 1.0, tl.float32)
    if WEIGHTED:
        own_weight = _share(weights, rows, column, width, height, mine)
    if L1:
        total += tl.load(scales + 1) * own_weight * _sign(d)
    if EDGES:
        left, right = mine & (column > 0), mine & (column + 1 < width)
        above, below = mine & (rows > 0), mine & (rows + 1 < height)
        from_left = tl.where(left, _sign(d - _error(prediction, target, here - channels, left)), 0.0)
        to_right = tl.where(right, _sign(_error(prediction, target, here + channels, right) - d), 0.0)
        from_above = tl.where(above, _sign(d - _error(prediction, target, here - length, above)), 0.0)
        to_below = tl.where(below, _sign(_error(prediction, target, here + length, below) - d), 0.0)
        if WEIGH_ALL:
            from_left *= 0.5 * (own_weight + _share(weights, rows, column - 1, width, height, left))
            to_right *= 0.5 * (own_weight + _share(weights, rows, column + 1, width, height, right))
            from_above *= 0.5 * (own_weight + _share(weights, rows - 1, column, width, height, above))
            to_below *= 0.5 * (own_weight + _share(weights, rows + 1, column, width, height, below))
        total += tl.load(scales + 2) * (from_left - to_right) + tl.load(scales + 3) * (from_above - to_below)
    tl.store(result + here, total, mask=mine)
