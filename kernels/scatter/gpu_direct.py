"""Triton kernels of the direct scatter: every target gathers from the sources around it, every source's gradient from
the targets around it, so nothing is added up by atomics and bits repeat.

Planes are (P, H, W). The loops of a tile reach as far as its farthest-reaching neighbour makes necessary, which a first
pair of kernels finds on the device: the host never waits for a radius.
"""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_rim import (
    AREA_EPSILON,
    BRIGHT,
    FOCUS_EXPONENT,
    LOG2_E,
    band_of,
    factor_of,
    length,
    range_of,
    weight_and_slope,
    weight_of,
)


@triton.jit
def pack_sources(image, signed_radius, planes, sums, size, largest_radius, AREA: tl.constexpr, BLOCK: tl.constexpr):
    """Planes of radius, share times colour, share. A radius that isn't finite, or above the largest, gets the share
    NaN, and so the image NaN. sums: (5, programs), of which the first three rows are written:
    a block's largest magnitude, the sum of its magnitudes, and its largest radius that is a number."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    radius = tl.abs(tl.load(signed_radius + at, mask=inside, other=0.0))
    share = tl.full((BLOCK,), 1.0, tl.float32)
    if AREA:
        share = 1.0 / (radius * radius + AREA_EPSILON)
    share = tl.where(radius <= largest_radius, share, float("nan"))
    tl.store(planes + at, radius, mask=inside)
    peak = tl.zeros((BLOCK,), tl.float32)
    total = tl.zeros((BLOCK,), tl.float32)
    for channel in tl.static_range(3):
        colour = tl.load(image + at * 3 + channel, mask=inside, other=0.0)
        tl.store(planes + (1 + channel) * size + at, share * colour, mask=inside)
        peak = tl.maximum(peak, tl.abs(colour))
        total += tl.abs(colour)
    tl.store(planes + 4 * size + at, share, mask=inside)
    program, programs = tl.program_id(0), tl.num_programs(0)
    tl.store(sums + program, tl.max(peak, 0))
    tl.store(sums + programs + program, tl.sum(total, 0))
    tl.store(sums + 2 * programs + program, tl.max(tl.where(radius >= 0.0, radius, 0.0), 0))


@triton.jit
def _row_sum(row, count, BLOCK: tl.constexpr):
    """Of `count` numbers, always in the same order."""
    total = tl.zeros((BLOCK,), tl.float32)
    for start in range(0, count, BLOCK):
        at = start + tl.arange(0, BLOCK)
        total += tl.load(row + at, mask=at < count, other=0.0)
    return tl.sum(total, 0)


@triton.jit
def _row_max(row, count, BLOCK: tl.constexpr):
    """Of `count` numbers from 0 on."""
    largest = tl.zeros((BLOCK,), tl.float32)
    for start in range(0, count, BLOCK):
        at = start + tl.arange(0, BLOCK)
        largest = tl.maximum(largest, tl.load(row + at, mask=at < count, other=0.0))
    return tl.max(largest, 0)


@triton.jit
def sum_usual(image, sums, size, programs, BLOCK: tl.constexpr, PIXELS: tl.constexpr):
    """The last two rows of `sums` (see `pack_sources`): the sum of a block's magnitudes that are no highlights, and how
    many they are. PIXELS: of a block."""
    mean = _row_sum(sums + programs, programs, BLOCK) / (3.0 * size)
    program = tl.program_id(0)
    at = program * PIXELS + tl.arange(0, PIXELS)
    total = tl.zeros((PIXELS,), tl.float32)
    usual = tl.zeros((PIXELS,), tl.float32)
    for channel in tl.static_range(3):
        magnitude = tl.abs(tl.load(image + at * 3 + channel, mask=at < size, other=float("inf")))
        counted = magnitude <= BRIGHT * mean
        total += tl.where(counted, magnitude, 0.0)
        usual += tl.where(counted, 1.0, 0.0)
    tl.store(sums + 3 * programs + program, tl.sum(total, 0))
    tl.store(sums + 4 * programs + program, tl.sum(usual, 0))


@triton.jit
def join_sums(sums, brightness, size, programs, BLOCK: tl.constexpr):
    """brightness: (3,), the largest magnitude of the image, the mean of those that are no highlights, the largest
    radius. The first two are 1 where the image isn't finite, as then the result isn't either."""
    largest = _row_max(sums, programs, BLOCK)
    total = _row_sum(sums + programs, programs, BLOCK)
    mean = total / (3.0 * size)
    without = _row_sum(sums + 3 * programs, programs, BLOCK)
    without /= tl.maximum(_row_sum(sums + 4 * programs, programs, BLOCK), 1.0)
    mean = tl.where(largest <= BRIGHT * mean, mean, without)
    known = total < float("inf")  # false for NaN too
    tl.store(brightness, tl.where(known, largest, 1.0))
    tl.store(brightness + 1, tl.where(known, mean, 1.0))
    tl.store(brightness + 2, _row_max(sums + 2 * programs, programs, BLOCK))


@triton.jit
def tile_reach(
    image, signed_radius, brightness, reach, bounds, height, width, alpha, stop, shortest, obstruction, largest_radius,
    TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
):  # fmt: skip
    """How far the sources of each tile are followed, pixels; and bounds, (4, tiles), of their `range_of`, least near
    and hole_near, largest far and hole_far. brightness, stop: see `band_of`; the others: see `range_of`."""
    y = tl.program_id(0) * TILE_Y + tl.arange(0, TILE_Y)[:, None]
    x = tl.program_id(1) * TILE_X + tl.arange(0, TILE_X)[None, :]
    inside = (y < height) & (x < width)
    at = y * width + x
    radius = tl.abs(tl.load(signed_radius + at, mask=inside, other=0.0))
    peak = tl.zeros((TILE_Y, TILE_X), tl.float32)
    for channel in tl.static_range(3):
        peak = tl.maximum(peak, tl.abs(tl.load(image + at * 3 + channel, mask=inside, other=0.0)))
    band = band_of(peak, brightness, height * width, stop) / (2.0 * alpha)
    least = (FOCUS_EXPONENT + stop) / (2.0 * alpha)
    far = tl.maximum(radius + band, least)
    # A comparison with NaN is false, so a source without a radius isn't followed.
    far = tl.where(inside & (far >= 0.0), tl.minimum(far, 1.0 * (height + width)), 0.0)
    tile = tl.program_id(0) * tl.num_programs(1) + tl.program_id(1)
    tiles = tl.num_programs(0) * tl.num_programs(1)
    tl.store(reach + tile, tl.max(tl.max(far, 1), 0))
    near, gone, hole_near, hole_far = range_of(radius, band, least, shortest, obstruction, inside, largest_radius)
    tl.store(bounds + tile, tl.min(tl.min(near, 1), 0))
    tl.store(bounds + tiles + tile, tl.max(tl.max(gone, 1), 0))
    tl.store(bounds + 2 * tiles + tile, tl.min(tl.min(hole_near, 1), 0))
    tl.store(bounds + 3 * tiles + tile, tl.max(tl.max(hole_far, 1), 0))


@triton.jit
def tile_window(
    reach, window, rows, columns, TILE_Y: tl.constexpr, TILE_X: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """How far from each tile the sources lie that reach it, whole pixels: the farthest reach of any tile whose reach
    bridges the gap between the two."""
    mine = tl.program_id(0)
    my_row, my_column = mine // columns, mine % columns
    farthest = tl.zeros((BLOCK,), tl.float32)
    for first in range(0, rows * columns, BLOCK):
        other = first + tl.arange(0, BLOCK)
        far = tl.load(reach + other, mask=other < rows * columns, other=0.0)
        gap_y = tl.maximum(tl.abs(other // columns - my_row) - 1, 0) * TILE_Y
        gap_x = tl.maximum(tl.abs(other % columns - my_column) - 1, 0) * TILE_X
        gap = (gap_y * gap_y + gap_x * gap_x).to(tl.float32)
        farthest = tl.maximum(farthest, tl.where(far * far >= gap, far, 0.0))
    tl.store(window + mine, tl.ceil(tl.max(farthest, 0)).to(tl.int32))


@triton.jit
def with_source(
    red, green, blue, weights, planes, x, row, dx, dy, height, width, steepness, factors, obstruction,
    SHAPED: tl.constexpr, STOPPED: tl.constexpr,
):  # fmt: skip
    """Sums of light and weights with that of one more source for each target: of the one at (dx, dy) from it, which is
    in row `row`. planes: `pack_sources`."""
    column = x + dx
    there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    at, size = row * width + column, height * width
    radius = tl.load(planes + at, mask=there, other=0.0)
    if SHAPED:
        # Seen from the source, the target lies in the opposite direction.
        radius = radius * factor_of(factors, -dx, -dy, height, width)
    weight = weight_of(radius, length(dx, dy), steepness, obstruction, STOPPED)
    red += weight * tl.load(planes + size + at, mask=there, other=0.0)
    green += weight * tl.load(planes + 2 * size + at, mask=there, other=0.0)
    blue += weight * tl.load(planes + 3 * size + at, mask=there, other=0.0)
    weights += weight * tl.load(planes + 4 * size + at, mask=there, other=0.0)
    return red, green, blue, weights


@triton.jit
def store_light(red, green, blue, weights, blurred, total, y, x, height, width):
    """Colours from sums of light and weights, and the sums of weights."""
    inside = (y < height) & (x < width)
    at = y * width + x
    tl.store(blurred + at * 3, red / weights, mask=inside)
    tl.store(blurred + at * 3 + 1, green / weights, mask=inside)
    tl.store(blurred + at * 3 + 2, blue / weights, mask=inside)
    tl.store(total + at, weights, mask=inside)


@triton.jit
def gather(
    planes, window, blurred, total, height, width, linear_from, alpha, factors, obstruction,
    SHAPED: tl.constexpr, STOPPED: tl.constexpr, TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
):  # fmt: skip
    """Each target's colour, and the sum of weights that it was divided by. Tiles that sources reach from `linear_from`
    pixels away or more are left to the linear form."""
    far = tl.load(window + tl.program_id(0) * tl.num_programs(1) + tl.program_id(1))
    if far >= linear_from:
        return
    top, left = tl.program_id(0) * TILE_Y, tl.program_id(1) * TILE_X
    y = top + tl.arange(0, TILE_Y)[:, None]
    x = left + tl.arange(0, TILE_X)[None, :]
    steepness = 2.0 * alpha * LOG2_E
    red = tl.zeros((TILE_Y, TILE_X), tl.float32)
    green = tl.zeros((TILE_Y, TILE_X), tl.float32)
    blue = tl.zeros((TILE_Y, TILE_X), tl.float32)
    weights = tl.zeros((TILE_Y, TILE_X), tl.float32)
    rows = tl.minimum(far, height - 1)
    # Rows and columns outside of the image are skipped.
    for dy in range(tl.maximum(-rows, -top - (TILE_Y - 1)), tl.minimum(rows, height - 1 - top) + 1):
        columns = tl.minimum(tl.sqrt((far * far - dy * dy).to(tl.float32)).to(tl.int32) + 1, width - 1)
        row = y + dy
        for dx in range(tl.maximum(-columns, -left - (TILE_X - 1)), tl.minimum(columns, width - 1 - left) + 1):
            red, green, blue, weights = with_source(
                red, green, blue, weights, planes, x, row, dx, dy, height, width, steepness, factors, obstruction,
                SHAPED, STOPPED,
            )  # fmt: skip
    store_light(red, green, blue, weights, blurred, total, y, x, height, width)


@triton.jit
def pack_targets(gradient, blurred, total, planes, size, BLOCK: tl.constexpr):
    """Planes of what a weight at each target is worth: the gradient with respect to colour over the sum of weights, and
    its product with the blurred colour, which the sum of weights costs."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    over = 1.0 / tl.load(total + at, mask=inside, other=1.0)
    cost = tl.zeros((BLOCK,), tl.float32)
    for channel in tl.static_range(3):
        worth = over * tl.load(gradient + at * 3 + channel, mask=inside, other=0.0)
        cost += worth * tl.load(blurred + at * 3 + channel, mask=inside, other=0.0)
        tl.store(planes + channel * size + at, worth, mask=inside)
    tl.store(planes + 3 * size + at, cost, mask=inside)


@triton.jit
def with_target(
    red, green, blue, costs, by_rim, targets, x, row, dx, dy, height, width,
    radius, own_red, own_green, own_blue, alpha, factors, obstruction,
    SHAPED: tl.constexpr, STOPPED: tl.constexpr,
):  # fmt: skip
    """The sums of `gather_gradient` with one more target for each source: the one at (dx, dy) from it, which is in row
    `row`. targets: `pack_targets`."""
    column = x + dx
    there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    at, size = row * width + column, height * width
    factor = 1.0
    if SHAPED:
        factor = factor_of(factors, dx, dy, height, width)
    rim, slope = weight_and_slope(radius, factor, length(dx, dy), alpha, obstruction, STOPPED)
    worth_red = tl.load(targets + at, mask=there, other=0.0)
    worth_green = tl.load(targets + size + at, mask=there, other=0.0)
    worth_blue = tl.load(targets + 2 * size + at, mask=there, other=0.0)
    cost = tl.load(targets + 3 * size + at, mask=there, other=0.0)
    red += rim * worth_red
    green += rim * worth_green
    blue += rim * worth_blue
    costs += rim * cost
    by_rim += slope * (worth_red * own_red + worth_green * own_green + worth_blue * own_blue - cost)
    return red, green, blue, costs, by_rim


@triton.jit
def store_gradient(
    red, green, blue, costs, by_rim, own_red, own_green, own_blue, signed, by_image, by_radius, at, inside,
    AREA: tl.constexpr,
):  # fmt: skip
    """Gradients with respect to a source's colour and signed radius from its sums over targets: see
    `gather_gradient`."""
    radius = tl.abs(signed)
    share = tl.zeros_like(radius) + 1.0
    gradient = by_rim
    if AREA:
        by_share = red * own_red + green * own_green + blue * own_blue - costs
        share = 1.0 / (radius * radius + AREA_EPSILON)
        gradient = share * (by_rim - 2.0 * radius * share * by_share)
    tl.store(by_image + at * 3, share * red, mask=inside)
    tl.store(by_image + at * 3 + 1, share * green, mask=inside)
    tl.store(by_image + at * 3 + 2, share * blue, mask=inside)
    tl.store(by_radius + at, tl.where(signed >= 0.0, gradient, -gradient), mask=inside)


@triton.jit
def gather_gradient(
    targets, reach, image, signed_radius, by_image, by_radius, height, width, linear_from, alpha, factors, obstruction,
    AREA: tl.constexpr, SHAPED: tl.constexpr, STOPPED: tl.constexpr, TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
):  # fmt: skip
    """Each source's gradient, from the targets that it reaches.

    The weight is rim times share. Summed up are rim times worth (red, green, blue), rim times cost, and the rim's slope
    by the radius times the gradient with respect to the weight. Tiles that reach `linear_from` pixels or more are left
    to the linear form."""
    far = tl.ceil(tl.load(reach + tl.program_id(0) * tl.num_programs(1) + tl.program_id(1))).to(tl.int32)
    if far >= linear_from:
        return
    top, left = tl.program_id(0) * TILE_Y, tl.program_id(1) * TILE_X
    y = top + tl.arange(0, TILE_Y)[:, None]
    x = left + tl.arange(0, TILE_X)[None, :]
    inside = (y < height) & (x < width)
    own = y * width + x
    signed = tl.load(signed_radius + own, mask=inside, other=0.0)
    radius = tl.abs(signed)
    own_red = tl.load(image + own * 3, mask=inside, other=0.0)
    own_green = tl.load(image + own * 3 + 1, mask=inside, other=0.0)
    own_blue = tl.load(image + own * 3 + 2, mask=inside, other=0.0)
    red = tl.zeros((TILE_Y, TILE_X), tl.float32)
    green = tl.zeros((TILE_Y, TILE_X), tl.float32)
    blue = tl.zeros((TILE_Y, TILE_X), tl.float32)
    costs = tl.zeros((TILE_Y, TILE_X), tl.float32)
    by_rim = tl.zeros((TILE_Y, TILE_X), tl.float32)
    rows = tl.minimum(far, height - 1)
    # Rows and columns outside of the image are skipped.
    for dy in range(tl.maximum(-rows, -top - (TILE_Y - 1)), tl.minimum(rows, height - 1 - top) + 1):
        columns = tl.minimum(tl.sqrt((far * far - dy * dy).to(tl.float32)).to(tl.int32) + 1, width - 1)
        row = y + dy
        for dx in range(tl.maximum(-columns, -left - (TILE_X - 1)), tl.minimum(columns, width - 1 - left) + 1):
            red, green, blue, costs, by_rim = with_target(
                red, green, blue, costs, by_rim, targets, x, row, dx, dy, height, width,
                radius, own_red, own_green, own_blue, alpha, factors, obstruction, SHAPED, STOPPED,
            )  # fmt: skip
    store_gradient(
        red, green, blue, costs, by_rim, own_red, own_green, own_blue, signed, by_image, by_radius, own, inside, AREA
    )
