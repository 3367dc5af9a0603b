"""The gradient of the direct form: every source gathers the gradient over its own circle of confusion.

With g_j the gradient with respect to the target's sums (colours and weight), D_ij = q_i (c_i . g_j) and q the area
term:

    dL/dc_i = q_i sum_j S_ij g_j,   dL/dR_i = sum_j S'_ij D_ij - 2 R_i q_i sum_j S_ij D_ij,   S' = dS/dR.

For a disc the targets above and below, left and right of the source have the same S, so their gradients are added
first: rows once for a strip of sources, columns in the inner loop.

D_ii is computed from the difference of colours and kept in a plane of its own: near focus blurred and sharp colour
agree to many digits, and in c_i . g_i only rounding noise would remain.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.core.lens import AREA_EPSILON
from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd_memory import load8, store8

from .cpu_pack import BLOCK, PLANES, RATIONAL, SUMS, Edges, Geometry, half_width, logistic2
from .op import COLOURS

STRIP = 64  # sources of a task in x
ROWS = 16  # and in y
LANES = 8
_ONE, _NONE = np.float32(1.0), np.float32(0.0)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def pack_gradient(gradient, image, blurred, total, sizes):
    """Gradient with respect to the sums before the division, planes (H, SUMS, stride), flat; and D_ii / q_i, (H,
    stride), flat."""
    height, width, pad = sizes.height, sizes.width, sizes.pad
    planes = np.zeros((height, SUMS, sizes.stride), np.float32)
    own = np.zeros((height, sizes.stride), np.float32)
    for y in prange(height):
        for x in range(width):
            share = _ONE / total[y, x]
            by_total = own_product = _NONE
            for channel in range(COLOURS):
                by_sum = gradient[y, x, channel] * share
                planes[y, channel, pad + x] = by_sum
                by_total -= by_sum * blurred[y, x, channel]
                own_product += by_sum * (image[y, x, channel] - blurred[y, x, channel])
            planes[y, COLOURS, pad + x] = by_total
            own[y, pad + x] = own_product
    return planes.reshape(-1), own.reshape(-1)


@internal(error_model="numpy")
def _add_rows(lines, planes, y, dy, height, stride, low, count, folded):
    """lines (SUMS, count) = gradient of row y + dy, plus that of y - dy where the shape is folded."""
    for plane in range(SUMS):
        to = plane * count
        below = ((y + dy) * SUMS + plane) * stride + low
        above = ((y - dy) * SUMS + plane) * stride + low
        if 0 <= y + dy < height:
            if folded and dy > 0 and y - dy >= 0:
                for i in range(0, count, LANES):
                    store8(lines, to + i, load8(planes, below + i) + load8(planes, above + i))
            else:
                for i in range(0, count, LANES):
                    store8(lines, to + i, load8(planes, below + i))
        else:
            for i in range(0, count, LANES):
                store8(lines, to + i, load8(planes, above + i))


@internal(error_model="numpy")
def _load4(lines, at, count):
    return load8(lines, at), load8(lines, at + count), load8(lines, at + 2 * count), load8(lines, at + 3 * count)


@internal(error_model="numpy")
def _load4_mirrored(lines, at, dx, count):
    return (
        load8(lines, at + dx) + load8(lines, at - dx),
        load8(lines, at + count + dx) + load8(lines, at + count - dx),
        load8(lines, at + 2 * count + dx) + load8(lines, at + 2 * count - dx),
        load8(lines, at + 3 * count + dx) + load8(lines, at + 3 * count - dx),
    )


@internal(error_model="numpy")
def _load5(planes, at, step):
    return (
        load8(planes, at),
        load8(planes, at + step),
        load8(planes, at + 2 * step),
        load8(planes, at + 3 * step),
        load8(planes, at + 4 * step),
    )


@internal(error_model="numpy")
def _store5(to, at, step, values):
    store8(to, at, values[0])
    store8(to, at + step, values[1])
    store8(to, at + 2 * step, values[2])
    store8(to, at + 3 * step, values[3])
    store8(to, at + 4 * step, values[4])


@internal(error_model="numpy")
def _product(gradient, source):
    return source[1] * gradient[0] + (source[2] * gradient[1] + (source[3] * gradient[2] + source[4] * gradient[3]))


@internal(error_model="numpy")
def _collect(sums, weight, slope, gradient, product):
    """Add one offset: S times the gradient with respect to three colours, S D and S' D."""
    return (
        sums[0] + weight * gradient[0],
        sums[1] + weight * gradient[1],
        sums[2] + weight * gradient[2],
        sums[3] + weight * product,
        sums[4] + slope * product,
    )


@internal(error_model="numpy")
def _rational(edge, outer):
    weight = _ONE / (_ONE + outer * edge)
    return weight, weight - weight * weight


@internal(error_model="numpy")
def _exponential(radius, outer, slope, stop, opacity):
    rim = logistic2(outer - slope * radius)
    by_radius = slope * (rim - rim * rim)
    if opacity > 0:
        hole = logistic2(outer - (stop * slope) * radius)
        opening = _ONE - opacity * hole
        return rim * opening, by_radius * opening - (opacity * stop * slope) * (hole - hole * hole) * rim
    return rim, by_radius


@internal(error_model="numpy")
def _visit_rational(sums, lines, at, count, source, own, own_at, dy, last, outer, entry):
    gradient = _load4(lines, at, count)
    weight, slope = _rational(source[0], outer[entry])
    product = source[4] * load8(own, own_at) if dy == 0 else _product(gradient, source)
    sums = _collect(sums, weight, slope, gradient, product)
    for dx in range(1, last + 1):
        gradient = _load4_mirrored(lines, at, dx, count)
        weight, slope = _rational(source[0], outer[entry + dx])
        sums = _collect(sums, weight, slope, gradient, _product(gradient, source))
    return sums


@internal(error_model="numpy")
def _visit_exponential(
    sums, lines, at, count, source, own, own_at, dy, last, outer, slope, entry, stop, opacity, folded
):
    # Tables are by source column minus target column; here the target is at +dx.
    gradient = _load4(lines, at, count)
    weight, steep = _exponential(source[0], outer[entry], slope[entry], stop, opacity)
    product = source[4] * load8(own, own_at) if dy == 0 else _product(gradient, source)
    sums = _collect(sums, weight, steep, gradient, product)
    if folded:
        for dx in range(1, last + 1):
            gradient = _load4_mirrored(lines, at, dx, count)
            weight, steep = _exponential(source[0], outer[entry + dx], slope[entry + dx], stop, opacity)
            sums = _collect(sums, weight, steep, gradient, _product(gradient, source))
        return sums
    for dx in range(1, last + 1):
        gradient = _load4(lines, at + dx, count)
        weight, steep = _exponential(source[0], outer[entry - dx], slope[entry - dx], stop, opacity)
        sums = _collect(sums, weight, steep, gradient, _product(gradient, source))
        gradient = _load4(lines, at - dx, count)
        weight, steep = _exponential(source[0], outer[entry + dx], slope[entry + dx], stop, opacity)
        sums = _collect(sums, weight, steep, gradient, _product(gradient, source))
    return sums


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _gather(sources, reach, gradient, own, sizes, kind, folded, outer, slope, stop, opacity):
    """Sums (H, strips, 5, STRIP): gradients with respect to the colours without the area term, then the sums of S D and
    S' D."""
    height, width, stride, pad = sizes.height, sizes.width, sizes.stride, sizes.pad
    reach_y, reach_x = sizes.reach_y, sizes.reach_x
    strips, bands = -(-width // STRIP), -(-height // ROWS)
    result = np.empty((height, strips, 5 * STRIP), np.float32)
    columns = 2 * reach_x + 1
    first_row = 0 if folded else -reach_y
    for task in prange(strips * bands):
        strip, part = task % strips, task // strips
        lines = np.empty(SUMS * (STRIP + 2 * BLOCK * -(-reach_x // BLOCK)), np.float32)
        left = pad + strip * STRIP
        end = min(STRIP, BLOCK * -(-(width - strip * STRIP) // BLOCK))
        for y in range(part * ROWS, min(height, part * ROWS + ROWS)):
            running = result[y, strip]
            running[:] = 0
            farthest = np.float32(-1.0)
            for block in range(left // BLOCK, (left + end) // BLOCK):
                farthest = max(farthest, reach[y, block])
            for dy in range(first_row, reach_y + 1):
                widest = min(half_width(farthest, dy), reach_x)
                below, above = 0 <= y + dy < height, folded and dy > 0 and y - dy >= 0
                if widest < 0 or not (below or above):
                    continue
                around = BLOCK * -(-widest // BLOCK)
                count = end + 2 * around
                _add_rows(lines, gradient, y, dy, height, stride, left - around, count, folded)
                entry = (dy - first_row) * columns + reach_x
                for start in range(0, end, BLOCK):
                    block = (left + start) // BLOCK
                    last = min(half_width(reach[y, block], dy), reach_x)
                    if last < 0:
                        continue
                    for i in range(start, start + BLOCK, LANES):
                        source = _load5(sources, y * PLANES * stride + left + i, stride)
                        sums = _load5(running, i, STRIP)
                        if kind == RATIONAL:
                            sums = _visit_rational(
                                sums, lines, around + i, count, source, own, y * stride + left + i, dy, last, outer,
                                entry,
                            )  # fmt: skip
                        else:
                            sums = _visit_exponential(
                                sums, lines, around + i, count, source, own, y * stride + left + i, dy, last, outer,
                                slope, entry, stop, opacity, folded,
                            )  # fmt: skip
                        _store5(running, i, STRIP, sums)
    return result


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _finish(sums, signed_radius, steepness, area_epsilon, area):
    """Apply the area term and the sign: gradients with respect to colour (H, W, COLOURS) and signed radius (H,
    W)."""
    height, width = signed_radius.shape
    by_colour = np.empty((height, width, COLOURS), np.float32)
    by_radius = np.empty((height, width), np.float32)
    for y in prange(height):
        for x in range(width):
            line, column = sums[y, x // STRIP], x % STRIP
            radius = abs(signed_radius[y, x])
            share = _ONE
            slope = steepness * line[4 * STRIP + column]
            if area:
                share = _ONE / (radius * radius + area_epsilon)
                slope -= np.float32(2.0) * radius * share * line[3 * STRIP + column]
            by_radius[y, x] = slope if signed_radius[y, x] >= 0 else -slope
            for channel in range(COLOURS):
                by_colour[y, x, channel] = share * line[channel * STRIP + column]
    return by_colour, by_radius


def backward(
    sources: np.ndarray, reach: np.ndarray, signed_radius: np.ndarray, gradient: np.ndarray, own: np.ndarray,
    sizes: Geometry, edge: Edges, alpha: float, area: bool,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Gradients with respect to the image (H, W, COLOURS) and the signed radius (H, W).

    sources, reach: from `pack_sources`; gradient, own: from `pack_gradient`.
    """
    sums = _gather(
        sources, reach, gradient, own, sizes, edge.kind, edge.folded, edge.outer, edge.slope, edge.stop, edge.opacity
    )
    # In the rational form the constant of dS/dR = 2 alpha S (1 - S) is still missing; in the other form tables are
    # exponents of 2.
    steepness = 2.0 * alpha if edge.kind == RATIONAL else math.log(2.0)
    return _finish(sums, signed_radius, np.float32(steepness), np.float32(AREA_EPSILON), area)
