"""The gradient of the linear form for discs: along a row a disc is a run of equal weights with soft ends.

S_k, the weight at dx = +-k of a row `dy` from the centre, falls from 1 to 0 over a few pixels. With
d_k = S_k - S_(k+1) a source gathers sum_k d_k (P[x + k + 1] - P[x - k]) with P the prefix sum of the
gradient, and with d'_k = dd_k/dR instead of d_k the gradient with respect to the radius. Only the few k where d_k isn't
zero are visited.

Three colours and the weight are four lanes of float64: float32 prefix sums would drift.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.core.lens import AREA_EPSILON
from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import any8, select8, splat8
from dofbench.runtime.simd_functions import floor8, max8, min8, sqrt8
from dofbench.runtime.simd_memory import load8, store8

from .cpu_double4 import load4, splat4, store4
from .cpu_pack import Geometry, half_width, logistic2
from .op import COLOURS

WAYS = COLOURS + 1  # lanes per pixel
LANES = 8  # number of sources whose soft ends are computed together
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@internal(error_model="numpy")
def _half_width8(radius, dy):
    """`half_width` for eight lanes."""
    rest = radius * radius - dy * dy
    return select8((radius >= _ZERO) & (rest >= _ZERO), floor8(sqrt8(max8(rest, _ZERO))), -_ONE)


@internal(error_model="numpy")
def _soft_ends(weights, slopes, cores, radius, dy, steepness, band, least, farthest):
    """Soft ends of eight sources at row `dy`: weights[8 e + lane] = d_k, slopes likewise d'_k, at k = cores[lane] + e.

    Before the soft end, up to k = core, S is 1; core = -1 if no pixel of the row has S = 1. Returns the number of
    values of e.
    """
    core = min8(_half_width8(radius - band, dy), farthest)
    last = min8(_half_width8(max8(radius + band, least), dy), farthest)
    store8(cores, 0, core)
    k = core
    inside = core >= _ZERO
    here, here_slope = select8(inside, _ONE, _ZERO), splat8(_ZERO)
    count = 0
    while any8(k <= last):
        k = k + _ONE
        further = logistic2((sqrt8(k * k + dy * dy) - radius) * steepness)
        further = select8(k <= last, further, _ZERO)
        further_slope = further - further * further
        if count == 0:
            # If no pixel has S = 1, there is no step away from such a pixel either.
            here, here_slope = select8(inside, here, further), select8(inside, here_slope, further_slope)
        store8(weights, count * LANES, here - further)
        store8(slopes, count * LANES, here_slope - further_slope)
        here, here_slope = further, further_slope
        count += 1
    return count


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _radii(signed_radius):
    """Magnitudes, (H, whole vectors), flat; and each row's largest."""
    height, width = signed_radius.shape
    radii = np.zeros((height, LANES * -(-width // LANES)), np.float32)
    largest = np.empty(height, np.float32)
    for y in prange(height):
        most = np.float32(-np.inf)
        for x in range(width):
            radii[y, x] = abs(signed_radius[y, x])
            most = max(most, radii[y, x])
        largest[y] = most
    return radii.reshape(-1), largest


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _prefix(gradient, image, blurred, total, pad):
    """Running sums of the gradient with respect to the sums before the division, (H, (W + 2 pad) * WAYS); and a
    correction of D_ii.

    The correction is the exact difference minus the rounded c_i . g_i: see cpu_direct_backward.py.
    """
    height, width = total.shape
    sums = np.empty((height, (width + 2 * pad) * WAYS), np.float64)
    correction = np.empty((height, width), np.float32)
    for y in prange(height):
        running = np.zeros(WAYS, np.float64)
        for x in range(pad):
            sums[y, x * WAYS : x * WAYS + WAYS] = 0
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
    return sums.reshape(-1), correction


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _gather(image, signed_radius, radii, largest, sums, correction, sizes, steepness, slope, area):
    """Gradients with respect to colour (H, W, COLOURS) and signed radius (H, W). slope: 2 alpha."""
    height, width, reach_y, reach_x = sizes.height, sizes.width, sizes.reach_y, sizes.reach_x
    band, least = np.float32(sizes.band), np.float32(sizes.least)
    pad = reach_x + 1
    columns, in_row = LANES * -(-width // LANES), (width + 2 * pad) * WAYS
    by_colour = np.empty((height, width, COLOURS), np.float32)
    by_radius = np.empty((height, width), np.float32)
    for y in prange(height):
        line = np.empty(in_row, np.float64)
        weights, slopes = np.empty((reach_x + 3) * LANES, np.float32), np.empty((reach_x + 3) * LANES, np.float32)
        cores = np.empty(LANES, np.float32)
        values, edges = np.zeros(width * WAYS, np.float64), np.zeros(width * WAYS, np.float64)
        for dy in range(min(reach_y, half_width(max(largest[y] + band, least), 0)) + 1):
            below, above = y + dy < height, dy > 0 and y - dy >= 0
            if not (below or above):
                continue
            for i in range(0, in_row, WAYS):
                gradient = splat4(0.0)
                if below:
                    gradient = gradient + load4(sums, (y + dy) * in_row + i)
                if above:
                    gradient = gradient + load4(sums, (y - dy) * in_row + i)
                store4(line, i, gradient)
            for start in range(0, width, LANES):
                count = _soft_ends(
                    weights, slopes, cores, load8(radii, y * columns + start), np.float32(dy), steepness, band, least,
                    np.float32(reach_x),
                )  # fmt: skip
                for lane in range(min(LANES, width - start)):
                    x, core = start + lane, int(cores[lane])
                    left, right = (pad + x - core) * WAYS, (pad + x + core + 1) * WAYS
                    value, edge = load4(values, x * WAYS), load4(edges, x * WAYS)
                    for e in range(min(count, reach_x - core + 1)):
                        run = load4(line, right) - load4(line, left)
                        value = value + splat4(np.float64(weights[e * LANES + lane])) * run
                        edge = edge + splat4(np.float64(slopes[e * LANES + lane])) * run
                        left -= WAYS
                        right += WAYS
                    store4(values, x * WAYS, value)
                    store4(edges, x * WAYS, edge)
        for x in range(width):
            radius = abs(signed_radius[y, x])
            share = np.float32(1.0) / (radius * radius + np.float32(AREA_EPSILON)) if area else np.float32(1.0)
            inside, rim = values[x * WAYS + COLOURS], edges[x * WAYS + COLOURS]
            for channel in range(COLOURS):
                inside += values[x * WAYS + channel] * image[y, x, channel]
                rim += edges[x * WAYS + channel] * image[y, x, channel]
                by_colour[y, x, channel] = share * values[x * WAYS + channel]
            centre = _ONE / (_ONE + np.exp(-slope * radius))
            inside += centre * correction[y, x]
            rim += (centre - centre * centre) * correction[y, x]
            total = share * slope * rim
            if area:
                total -= np.float32(2.0) * radius * share * share * inside
            by_radius[y, x] = total if signed_radius[y, x] >= 0 else -total
    return by_colour, by_radius


def backward(
    gradient: np.ndarray, image: np.ndarray, signed_radius: np.ndarray, blurred: np.ndarray, total: np.ndarray,
    sizes: Geometry, alpha: float, area: bool,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Gradients with respect to the image (H, W, COLOURS) and the signed radius (H, W)."""
    sums, correction = _prefix(gradient, image, blurred, total, sizes.reach_x + 1)
    radii, largest = _radii(signed_radius)
    return _gather(
        image, signed_radius, radii, largest, sums, correction, sizes, np.float32(2.0 * alpha * math.log2(math.e)),
        np.float32(2.0 * alpha), area,
    )  # fmt: skip
