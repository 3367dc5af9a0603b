"""Triton kernels of the direct scatter: every target gathers from the sources around it, every source's gradient from
the targets around it, so nothing is added up by atomics and bits repeat.

Planes are (P, H, W). The loops of a tile reach as far as its farthest-reaching neighbour makes necessary, which a first
pair of kernels finds on the device: the host never waits for a radius.
"""

from __future__ import annotations

import triton
import triton.language as tl

from dofbench.core import lens

from . import reference

# Sources are followed until exp(-tail) of their full weight, as on the CPU (cpu_pack.py).
BAND_EXPONENT = tl.constexpr(12.0)
FOCUS_EXPONENT = tl.constexpr(18.0)
USUAL_CONTRAST = tl.constexpr(4.0)
BRIGHT = tl.constexpr(2.718281828459045 * 4.0)
SMALLEST_MEAN = tl.constexpr(1e-30)
AREA_EPSILON = tl.constexpr(lens.AREA_EPSILON)
STOP_OPACITY = tl.constexpr(reference.STOP_OPACITY)
LOG2_E = tl.constexpr(1.4426950408889634)


@triton.jit
def pack_sources(image, signed_radius, planes, size, largest_radius, AREA: tl.constexpr, BLOCK: tl.constexpr):
    """Planes of radius, share times colour, share. A radius that isn't finite, or above the largest, gets the share
    NaN, so that whoever looks at the picture finds it."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < size
    radius = tl.abs(tl.load(signed_radius + at, mask=inside, other=0.0))
    share = tl.full((BLOCK,), 1.0, tl.float32)
    if AREA:
        share = 1.0 / (radius * radius + AREA_EPSILON)
    share = tl.where(radius <= largest_radius, share, float("nan"))
    tl.store(planes + at, radius, mask=inside)
    for channel in tl.static_range(3):
        colour = tl.load(image + at * 3 + channel, mask=inside, other=0.0)
        tl.store(planes + (1 + channel) * size + at, share * colour, mask=inside)
    tl.store(planes + 4 * size + at, share, mask=inside)


@triton.jit
def tile_reach(
    image, signed_radius, brightness, reach, height, width, alpha, stop,
    TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
):  # fmt: skip
    """How far the sources of each tile are followed, pixels. brightness: largest and mean magnitude of the image, and
    the largest radius, on the device. stop: what an obstruction adds to the exponents."""
    y = tl.program_id(0) * TILE_Y + tl.arange(0, TILE_Y)[:, None]
    x = tl.program_id(1) * TILE_X + tl.arange(0, TILE_X)[None, :]
    inside = (y < height) & (x < width)
    at = y * width + x
    radius = tl.abs(tl.load(signed_radius + at, mask=inside, other=0.0))
    largest, mean, widest = tl.load(brightness), tl.load(brightness + 1), tl.load(brightness + 2)
    peak = tl.zeros((TILE_Y, TILE_X), tl.float32)
    for channel in tl.static_range(3):
        peak = tl.maximum(peak, tl.abs(tl.load(image + at * 3 + channel, mask=inside, other=0.0)))
    # Tails matter more beside a highlight, and for sharp sources where the others spread far beyond a small image.
    contrast = tl.maximum(1.0, largest / tl.maximum(mean, SMALLEST_MEAN) / USUAL_CONTRAST)
    spread = tl.maximum(1.0, widest * widest / (height * width))
    common = BAND_EXPONENT + tl.log(spread) + stop
    band = tl.where(
        peak > BRIGHT * mean, common + tl.log(contrast), common + tl.log(tl.minimum(contrast, BRIGHT / USUAL_CONTRAST))
    )
    far = tl.maximum(radius + band / (2.0 * alpha), (FOCUS_EXPONENT + stop) / (2.0 * alpha))
    # A comparison with NaN is false, so a source without a radius isn't followed.
    far = tl.where(inside & (far >= 0.0), tl.minimum(far, 1.0 * (height + width)), 0.0)
    tl.store(reach + tl.program_id(0) * tl.num_programs(1) + tl.program_id(1), tl.max(tl.max(far, 1), 0))


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
def _length(dx, dy):
    """(1, 1), since loop counters are Python's own numbers when kernels are interpreted."""
    return tl.sqrt(tl.zeros((1, 1), tl.float32) + (dx * dx + dy * dy))


@triton.jit
def _radius_factor(dx, dy, distance, normals, blades, apothem, curvature):
    """The aperture's radius in direction (dx, dy) as a share of a corner's. normals: of the polygon's edges. The edge
    in a direction is the one whose normal is nearest to it."""
    nearest = tl.zeros((1, 1), tl.float32)
    for blade in range(blades):
        along = tl.load(normals + 2 * blade) * dx + tl.load(normals + 2 * blade + 1) * dy
        nearest = tl.maximum(nearest, along)
    straight = tl.where(distance > 0.0, apothem * distance / tl.where(distance > 0.0, nearest, 1.0), 1.0)
    return tl.where(distance > 0.0, (1.0 - curvature) * straight + curvature, 1.0)


@triton.jit
def _rim(inside_by, steepness):
    """1/2 + 1/2 tanh(alpha t) of t pixels inside the rim; steepness: 2 alpha log2(e)."""
    return 1.0 / (1.0 + tl.exp2(tl.minimum(-steepness * inside_by, 126.0)))


@triton.jit
def gather(
    planes, window, blurred, total, height, width, alpha, normals, blades, apothem, curvature, obstruction,
    SHAPED: tl.constexpr, STOPPED: tl.constexpr, TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
):  # fmt: skip
    """Each target's colour, and the sum of weights that it was divided by."""
    y = tl.program_id(0) * TILE_Y + tl.arange(0, TILE_Y)[:, None]
    x = tl.program_id(1) * TILE_X + tl.arange(0, TILE_X)[None, :]
    size = height * width
    steepness = 2.0 * alpha * LOG2_E
    far = tl.load(window + tl.program_id(0) * tl.num_programs(1) + tl.program_id(1))
    red = tl.zeros((TILE_Y, TILE_X), tl.float32)
    green = tl.zeros((TILE_Y, TILE_X), tl.float32)
    blue = tl.zeros((TILE_Y, TILE_X), tl.float32)
    weights = tl.zeros((TILE_Y, TILE_X), tl.float32)
    rows = tl.minimum(far, height - 1)
    for dy in range(-rows, rows + 1):
        columns = tl.minimum(tl.sqrt((far * far - dy * dy).to(tl.float32)).to(tl.int32) + 1, width - 1)
        row = y + dy
        for dx in range(-columns, columns + 1):
            column = x + dx
            there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            at = row * width + column
            distance = _length(dx, dy)
            radius = tl.load(planes + at, mask=there, other=0.0)
            if SHAPED:
                # Seen from the source, the target lies in the opposite direction.
                radius = radius * _radius_factor(-dx, -dy, distance, normals, blades, apothem, curvature)
            weight = _rim(radius - distance, steepness)
            if STOPPED:
                weight = weight * (1.0 - STOP_OPACITY * _rim(obstruction * radius - distance, steepness))
            red += weight * tl.load(planes + size + at, mask=there, other=0.0)
            green += weight * tl.load(planes + 2 * size + at, mask=there, other=0.0)
            blue += weight * tl.load(planes + 3 * size + at, mask=there, other=0.0)
            weights += weight * tl.load(planes + 4 * size + at, mask=there, other=0.0)
    inside = (y < height) & (x < width)
    at = y * width + x
    tl.store(blurred + at * 3, red / weights, mask=inside)
    tl.store(blurred + at * 3 + 1, green / weights, mask=inside)
    tl.store(blurred + at * 3 + 2, blue / weights, mask=inside)
    tl.store(total + at, weights, mask=inside)


@triton.jit
def pack_targets(gradient, blurred, total, planes, size, BLOCK: tl.constexpr):
    """Planes of what a weight at each target is worth: the gradient by colour over the sum of weights, and its product
    with the blurred colour, which the sum of weights costs."""
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
def gather_gradient(
    targets, reach, image, signed_radius, by_image, by_radius, height, width, alpha,
    normals, blades, apothem, curvature, obstruction,
    AREA: tl.constexpr, SHAPED: tl.constexpr, STOPPED: tl.constexpr, TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
):  # fmt: skip
    """Each source's gradient, from the targets that it reaches.

    The weight is rim times share. Summed up are rim times worth (red, green, blue), rim times cost, and the rim's slope
    by the radius times the gradient by the weight.
    """
    y = tl.program_id(0) * TILE_Y + tl.arange(0, TILE_Y)[:, None]
    x = tl.program_id(1) * TILE_X + tl.arange(0, TILE_X)[None, :]
    size = height * width
    steepness = 2.0 * alpha * LOG2_E
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
    far = tl.ceil(tl.load(reach + tl.program_id(0) * tl.num_programs(1) + tl.program_id(1))).to(tl.int32)
    rows = tl.minimum(far, height - 1)
    for dy in range(-rows, rows + 1):
        columns = tl.minimum(tl.sqrt((far * far - dy * dy).to(tl.float32)).to(tl.int32) + 1, width - 1)
        row = y + dy
        for dx in range(-columns, columns + 1):
            column = x + dx
            there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
            at = row * width + column
            distance = _length(dx, dy)
            factor = 1.0
            if SHAPED:
                factor = _radius_factor(dx, dy, distance, normals, blades, apothem, curvature)
            rim = _rim(radius * factor - distance, steepness)
            slope = 2.0 * alpha * factor * rim * (1.0 - rim)
            if STOPPED:
                stop = _rim(obstruction * radius * factor - distance, steepness)
                open_share = 1.0 - STOP_OPACITY * stop
                stop_slope = 2.0 * alpha * obstruction * factor * stop * (1.0 - stop)
                slope = slope * open_share - rim * STOP_OPACITY * stop_slope
                rim = rim * open_share
            worth_red = tl.load(targets + at, mask=there, other=0.0)
            worth_green = tl.load(targets + size + at, mask=there, other=0.0)
            worth_blue = tl.load(targets + 2 * size + at, mask=there, other=0.0)
            cost = tl.load(targets + 3 * size + at, mask=there, other=0.0)
            red += rim * worth_red
            green += rim * worth_green
            blue += rim * worth_blue
            costs += rim * cost
            by_rim += slope * (worth_red * own_red + worth_green * own_green + worth_blue * own_blue - cost)
    share = tl.full((TILE_Y, TILE_X), 1.0, tl.float32)
    by_share = red * own_red + green * own_green + blue * own_blue - costs
    gradient = by_rim
    if AREA:
        share = 1.0 / (radius * radius + AREA_EPSILON)
        gradient = share * (by_rim - 2.0 * radius * share * by_share)
    tl.store(by_image + own * 3, share * red, mask=inside)
    tl.store(by_image + own * 3 + 1, share * green, mask=inside)
    tl.store(by_image + own * 3 + 2, share * blue, mask=inside)
    tl.store(by_radius + own, tl.where(signed >= 0.0, gradient, -gradient), mask=inside)
