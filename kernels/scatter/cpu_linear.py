"""The linear form for discs: along a row a disc is a run of equal weights with soft ends, O(R) a pixel.

S_k, the weight at dx = +-k of a row `dy` from the centre, falls from 1 to 0 over a few pixels. With
d_k = S_k - S_(k+1) a source adds its colour times d_k at x - k and takes it away at x + k + 1; one prefix sum
then gives the row (kernels.md). Only the few k where d_k isn't zero are visited. The way back is the same
read backwards: sum_k d_k (P[x + k + 1] - P[x - k]) with P the prefix sum of the gradient, and with
d'_k = dd_k/dR instead of d_k the gradient by the radius.

Three colours and the weight are four lanes of float64, so that highlights leave no trace in the dark
pixels after them: what was added is taken away to within 1e-16 of the highlight.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.lens import AREA_EPSILON
from dofbench.numba_math import load8, store8

from .cpu_edge import half_width, logistic2
from .cpu_pack import COLOURS, Geometry
from .double4 import load4, splat4, store4

WAYS = COLOURS + 1  # lanes of a pixel
LANES = 8
MARGIN = 8          # offsets visited beyond the last one that counts, as whole vectors are done


@njit(cache=True, error_model="numpy")
def _soft_end(weights, radius, distances, entry, dy, steepness, band, least, farthest):
    """The soft end of one source's row: weights[e] = S at k = first + e, e = 0 ... count, the last one 0.

    Returns first and count. S at `first` stands for all that is inside of it; first = -1 where nothing is.
    """
    core = min(half_width(radius - band, dy), farthest)
    last = min(half_width(max(radius + band, least), dy), farthest)
    count = last - core + 1
    for e in range(0, count - 1, LANES):
        store8(weights, 1 + e, logistic2((load8(distances, entry + core + 1 + e) - radius) * steepness))
    weights[count] = np.float32(0.0)
    # Without an inside there is no step from it either.
    weights[0] = np.float32(1.0) if core >= 0 else weights[1]
    return core, count


@njit(parallel=True, cache=True, error_model="numpy")
def _pack(image, signed_radius, area):
    """Colour and 1, both times the area term, (H, W * WAYS); and the largest radius of every row, (H,)."""
    height, width = signed_radius.shape
    sources = np.empty((height, width * WAYS), np.float32)
    largest = np.empty(height, np.float32)
    for y in prange(height):
        most = np.float32(0.0)
        for x in range(width):
            radius = abs(signed_radius[y, x])
            most = max(most, radius)
            share = np.float32(1.0)
            if area:
                share = np.float32(1.0) / (radius * radius + np.float32(AREA_EPSILON))
            for channel in range(COLOURS):
                sources[y, x * WAYS + channel] = share * image[y, x, channel]
            sources[y, x * WAYS + COLOURS] = share
        largest[y] = most
    return sources, largest


@njit(parallel=True, cache=True, error_model="numpy")
def _spread(sources, largest, signed_radius, sizes, rows, distances, steepness):
    """Sums by bands of `rows` source rows: (bands, target rows of the band, W * WAYS)."""
    height, width, reach_y, reach_x = sizes.height, sizes.width, sizes.reach_y, sizes.reach_x
    band, least = np.float32(sizes.band), np.float32(sizes.least)
    bands, pad = -(-height // rows), reach_x + 1
    buffers = np.empty((bands, (rows + 2 * reach_y) * width * WAYS), np.float32)
    columns = distances.shape[1]
    table = distances.reshape(-1)
    for part in prange(bands):
        buffer = buffers[part]
        buffer[:] = 0
        steps = np.empty((width + 2 * pad) * WAYS, np.float64)
        weights = np.empty(reach_x + 3 + 2 * LANES, np.float32)
        for y in range(part * rows, min(height, part * rows + rows)):
            for dy in range(min(reach_y, half_width(max(largest[y] + band, least), 0)) + 1):
                below, above = y + dy < height, dy > 0 and y - dy >= 0
                if not (below or above):
                    continue
                steps[:] = 0
                for x in range(width):
                    core, count = _soft_end(weights, abs(signed_radius[y, x]), table, dy * columns, dy, steepness,
                                            band, least, reach_x)
                    source = load4(sources[y], x * WAYS)
                    left, right = (pad + x - core) * WAYS, (pad + x + core + 1) * WAYS
                    for e in range(count):
                        part_of = splat4(np.float64(weights[e] - weights[e + 1])) * source
                        store4(steps, left, load4(steps, left) + part_of)
                        store4(steps, right, load4(steps, right) - part_of)
                        left -= WAYS
                        right += WAYS
                running = splat4(0.0)
                for x in range(pad):
                    running = running + load4(steps, x * WAYS)
                to = (y + dy - part * rows + reach_y) * width * WAYS
                mirrored = to - 2 * dy * width * WAYS
                for x in range(0, width * WAYS, WAYS):
                    running = running + load4(steps, pad * WAYS + x)
                    if below:
                        store4(buffer, to + x, load4(buffer, to + x) + running)
                    if above:
                        store4(buffer, mirrored + x, load4(buffer, mirrored + x) + running)
    return buffers


@njit(parallel=True, cache=True, error_model="numpy")
def _merge(buffers, height, width, rows, reach_y):
    """Sum the buffers that cover each row, in order, and divide: blurred (H, W, COLOURS), total (H, W)."""
    blurred = np.empty((height, width, COLOURS), np.float32)
    total = np.empty((height, width), np.float32)
    for y in prange(height):
        line = np.zeros(width * WAYS, np.float32)
        for part in range(max(0, (y - reach_y) // rows), min(buffers.shape[0] - 1, (y + reach_y) // rows) + 1):
            at = (y - part * rows + reach_y) * width * WAYS
            line += buffers[part, at:at + width * WAYS]
        for x in range(width):
            total[y, x] = line[x * WAYS + COLOURS]
            for channel in range(COLOURS):
                blurred[y, x, channel] = line[x * WAYS + channel] / total[y, x]
    return blurred, total


@njit(parallel=True, cache=True, error_model="numpy")
def _prefix(gradient, image, blurred, total, pad):
    """Running sums of the gradient by the sums before the division, (H, (W + 2 pad) * WAYS); and D_ii's correction.

    The correction is what c_i . g_i, rounded, lacks of the exact difference: see cpu_direct_backward.py.
    """
    height, width = total.shape
    sums = np.empty((height, (width + 2 * pad) * WAYS), np.float64)
    correction = np.empty((height, width), np.float32)
    for y in prange(height):
        running = np.zeros(WAYS, np.float64)
        for x in range(pad):
            sums[y, x * WAYS:x * WAYS + WAYS] = 0
        for x in range(width):
            at = (pad + x) * WAYS
            for way in range(WAYS):
                sums[y, at + way] = running[way]
            share = np.float32(1.0) / total[y, x]
            by_total = own = np.float32(0.0)
            product = 0.0
            for channel in range(COLOURS):
                by_sum = gradient[y, x, channel] * share
                running[channel] += by_sum
                by_total -= by_sum * blurred[y, x, channel]
                own += by_sum * (image[y, x, channel] - blurred[y, x, channel])
                product += np.float64(by_sum) * np.float64(image[y, x, channel])
            running[COLOURS] += by_total
            correction[y, x] = own - (product + by_total)
        for x in range(pad + width, width + 2 * pad):
            for way in range(WAYS):
                sums[y, x * WAYS + way] = running[way]
    return sums, correction


@njit(parallel=True, cache=True, error_model="numpy")
def _gather(image, signed_radius, sums, correction, sizes, distances, steepness, slope, area):
    """Gradients by colour (H, W, COLOURS) and by signed radius (H, W). slope: 2 alpha."""
    height, width, reach_y, reach_x = sizes.height, sizes.width, sizes.reach_y, sizes.reach_x
    band, least = np.float32(sizes.band), np.float32(sizes.least)
    pad = reach_x + 1
    columns = distances.shape[1]
    table = distances.reshape(-1)
    by_colour = np.empty((height, width, COLOURS), np.float32)
    by_radius = np.empty((height, width), np.float32)
    for y in prange(height):
        line = np.empty((width + 2 * pad) * WAYS, np.float64)
        weights = np.empty(reach_x + 3 + 2 * LANES, np.float32)
        values = np.zeros(width * WAYS, np.float64)
        slopes = np.zeros(width * WAYS, np.float64)
        centre = np.empty(width, np.float32)
        most = np.float32(0.0)
        for x in range(width):
            most = max(most, abs(signed_radius[y, x]))
        for dy in range(min(reach_y, half_width(max(most + band, least), 0)) + 1):
            below, above = y + dy < height, dy > 0 and y - dy >= 0
            if below and above:
                for i in range(0, line.size, WAYS):
                    store4(line, i, load4(sums[y + dy], i) + load4(sums[y - dy], i))
            elif below:
                line[:] = sums[y + dy]
            elif above:
                line[:] = sums[y - dy]
            else:
                continue
            for x in range(width):
                core, count = _soft_end(weights, abs(signed_radius[y, x]), table, dy * columns, dy, steepness,
                                        band, least, reach_x)
                if dy == 0:
                    centre[x] = weights[0] if core < 0 else np.float32(1.0)
                left, right = (pad + x - core) * WAYS, (pad + x + core + 1) * WAYS
                value, by_edge = load4(values, x * WAYS), load4(slopes, x * WAYS)
                here = weights[0]
                here_slope = here - here * here
                for e in range(count):
                    further = weights[e + 1]
                    further_slope = further - further * further
                    run = load4(line, right) - load4(line, left)
                    value = value + splat4(np.float64(here - further)) * run
                    by_edge = by_edge + splat4(np.float64(here_slope - further_slope)) * run
                    here, here_slope = further, further_slope
                    left -= WAYS
                    right += WAYS
                store4(values, x * WAYS, value)
                store4(slopes, x * WAYS, by_edge)
        for x in range(width):
            radius = abs(signed_radius[y, x])
            share = np.float32(1.0) / (radius * radius + np.float32(AREA_EPSILON)) if area else np.float32(1.0)
            inside, edge = values[x * WAYS + COLOURS], slopes[x * WAYS + COLOURS]
            for channel in range(COLOURS):
                inside += values[x * WAYS + channel] * image[y, x, channel]
                edge += slopes[x * WAYS + channel] * image[y, x, channel]
                by_colour[y, x, channel] = share * values[x * WAYS + channel]
            inside += centre[x] * correction[y, x]
            edge += (centre[x] - centre[x] * centre[x]) * correction[y, x]
            total = share * slope * edge
            if area:
                total -= np.float32(2.0) * radius * share * share * inside
            by_radius[y, x] = total if signed_radius[y, x] >= 0 else -total
    return by_colour, by_radius


def _distances(sizes: Geometry) -> np.ndarray:
    """(reach_y + 1, columns) distance of the offset (row, column) from the centre, float32."""
    rows = np.arange(sizes.reach_y + 1, dtype=np.float64)[:, None]
    columns = np.arange(sizes.reach_x + 2 + LANES, dtype=np.float64)[None, :]
    return np.hypot(rows, columns).astype(np.float32)


def forward(image: np.ndarray, signed_radius: np.ndarray, sizes: Geometry, alpha: float,
            area: bool) -> tuple[np.ndarray, np.ndarray]:
    """Blurred colours (H, W, COLOURS) and total weight (H, W)."""
    # Bands of this height keep the overlap to merge below three times the image.
    rows = max(32, sizes.reach_y)
    sources, largest = _pack(image, signed_radius, area)
    steepness = np.float32(2.0 * alpha * math.log2(math.e))
    buffers = _spread(sources, largest, signed_radius, sizes, rows, _distances(sizes), steepness)
    return _merge(buffers, sizes.height, sizes.width, rows, sizes.reach_y)


def backward(gradient: np.ndarray, image: np.ndarray, signed_radius: np.ndarray, blurred: np.ndarray,
             total: np.ndarray, sizes: Geometry, alpha: float, area: bool) -> tuple[np.ndarray, np.ndarray]:
    """Gradients by the image (H, W, COLOURS) and by the signed radius (H, W)."""
    sums, correction = _prefix(gradient, image, blurred, total, sizes.reach_x + 1)
    steepness = np.float32(2.0 * alpha * math.log2(math.e))
    return _gather(image, signed_radius, sums, correction, sizes, _distances(sizes), steepness,
                   np.float32(2.0 * alpha), area)
