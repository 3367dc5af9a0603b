"""The numba kernels behind `cpu.py`: a separable filter, tile by tile, and the computation of SSIM from its results.

The image is cut into tiles small enough for the cache. A tile is processed in one scratch buffer whose row length is a
compile-time constant, because only then LLVM can see that reads and writes don't overlap, and vectorise. Indices are
unsigned, since numba adds a wrap-around test to signed ones. Bands of rows run in parallel; sums are kept per band and
added in order, so the number of threads changes no bit.

fastmath isn't used: which products it fuses depends on the other code compiled in the same process, and a freshly
compiled kernel differed in the last bits from the same kernel loaded from numba's cache. Where a fused multiply-add is
wanted, it is written.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from llvmlite import ir
from numba import njit, prange, types
from numba.core import cgutils
from numba.extending import intrinsic

from dofbench.runtime.kernel_cache import PRANGE, cached

BAND = 16  # rows of a tile
_TILE_ROW = 768  # numbers (pixels times channels) in a row of a tile, rounded to whole pixels

_u = np.uint64
_ZERO, _ONE, _TWO, _THREE, _FOUR = _u(0), _u(1), _u(2), _u(3), _u(4)


@intrinsic
def _fma(typing_context, a, b, c):
    """a * b + c of three float32, with a single rounding if the processor supports it."""

    def generate(context, builder, signature, arguments):
        single = arguments[0].type
        kind = ir.FunctionType(single, (single, single, single))
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, "llvm.fmuladd.f32"), arguments)

    return types.float32(types.float32, types.float32, types.float32), generate


@njit(inline="always", error_model="numpy")
def _stage(scratch, at, image, y, left, padded, halo, centre):
    """Put image[y, left - halo : ] - centre into `padded` numbers from scratch[at]; zeros outside the image."""
    height, width = np.int64(image.shape[0]), np.int64(image.shape[1])
    first = max(np.int64(0), np.int64(halo) - np.int64(left))
    last = min(np.int64(padded), width + np.int64(halo) - np.int64(left))
    if y < 0 or y >= height:
        first = last = np.int64(0)
    for j in range(_ZERO, _u(first)):
        scratch[at + j] = np.float32(0)
    for j in range(_u(first), _u(last)):
        scratch[at + j] = image[_u(y), left + j - halo] - centre
    for j in range(_u(last), padded):
        scratch[at + j] = np.float32(0)


@njit(inline="always", error_model="numpy")
def _filter(scratch, source, goal, count, spacing, taps, weights):
    """scratch[goal + j] = sum_k weights[k] scratch[source + j + k spacing] for j < count."""
    for j in range(count):
        e = np.float32(0)
        for k in range(taps):
            e = _fma(weights[k], scratch[source + j + k * spacing], e)
        scratch[goal + j] = e


@njit(inline="always", error_model="numpy")
def _repeat(scratch, at, weight, used, y, left, count, channels):
    """Put the weights of `count` numbers of row y, from number `left` on, into scratch, once per channel; ones if there
    are no weights, or they aren't used."""
    if weight.shape[0] == 0 or not used:
        for j in range(count):
            scratch[at + j] = np.float32(1)
    else:
        for pixel in range(count // channels):
            for channel in range(channels):
                scratch[at + pixel * channels + channel] = weight[y, left // channels + pixel]


@cache
def build(radius: int, channels: int):
    """(forward, backward) for a window of 2 radius + 1 pixels and images with this number of channels."""
    reach, step, taps = _u(radius), _u(channels), _u(2 * radius + 1)
    halo = _u(radius * channels)
    tile = _u(max(1, _TILE_ROW // channels) * channels)
    stride = tile + _TWO * halo
    band = _u(BAND)
    plane = (band + _TWO * reach) * stride
    by_row, in_row = stride, step

    @cached
    @njit(error_model="numpy", parallel=PRANGE)
    def forward(p, t, weight, taps_weights, frame_y, frame_x, centre, c1, c2, with_l1, weigh_all, maps, sums):
        """Sum up 1 - S, times the weight if `weigh_all`, and weight |p - t|; write the derivatives of what of S was
        summed up, which `backward` filters.

        p, t: (H, W C). weight: (H, W) or empty. frame_y: (2, H) and frame_x: (2, W C), the window's
        mass inside the image and whether a pixel counts. maps: (3, H, W C), filled with the derivatives of S with
        respect to E[p], E[p^2 + t^2] and E[d^2]. sums: (bands, 2), filled.
        """
        height, width = _u(p.shape[0]), _u(p.shape[1])
        one, two = np.float32(1), np.float32(2)
        for b in prange(sums.shape[0]):
            # Rows: two staged planes; four after the vertical pass; four after both; two of sums; L1 weights.
            scratch = np.empty(_TWO * plane + _u(11) * stride, dtype=np.float32)
            column = _TWO * plane
            mixed = column + _FOUR * stride
            unlike = mixed + _FOUR * stride
            absolute = unlike + stride
            share = absolute + stride
            top = _u(b) * band
            bottom = min(top + band, height)
            sum_unlike = 0.0
            sum_l1 = 0.0
            for left in range(_ZERO, width, tile):
                count = min(tile, width - left)
                padded = count + _TWO * halo
                for r in range(_ZERO, bottom - top + _TWO * reach):
                    y_staged = np.int64(top + r) - np.int64(reach)
                    _stage(scratch, r * stride, p, y_staged, left, padded, halo, centre)
                    _stage(scratch, plane + r * stride, t, y_staged, left, padded, halo, centre)
                for j in range(count):
                    scratch[unlike + j] = np.float32(0)
                    scratch[absolute + j] = np.float32(0)
                for r in range(_ZERO, bottom - top):
                    y = top + r
                    at = r * stride
                    _filter(scratch, at, column, padded, by_row, taps, taps_weights)
                    _filter(scratch, plane + at, column + stride, padded, by_row, taps, taps_weights)
                    for j in range(padded):
                        e_sum = np.float32(0)
                        e_difference = np.float32(0)
                        for k in range(taps):
                            a = scratch[at + k * stride + j]
                            c = scratch[plane + at + k * stride + j]
                            d = a - c
                            e_sum = _fma(taps_weights[k], _fma(a, a, c * c), e_sum)
                            e_difference = _fma(taps_weights[k], d * d, e_difference)
                        scratch[column + _TWO * stride + j] = e_sum
                        scratch[column + _THREE * stride + j] = e_difference
                    for q in range(_FOUR):
                        _filter(scratch, column + q * stride, mixed + q * stride, count, in_row, taps, taps_weights)
                    _repeat(scratch, share, weight, weigh_all, y, left, count, step)
                    for j in range(count):
                        mass = frame_y[_ZERO, y] * frame_x[_ZERO, left + j]
                        counts = frame_y[_ONE, y] * frame_x[_ONE, left + j] * scratch[share + j]
                        # The zeros beyond the border aren't shifted by `centre`, so mean and variance are corrected
                        # where the window isn't completely inside the image.
                        missing = centre * (one - mass)
                        a = scratch[mixed + j]
                        c = scratch[mixed + stride + j]
                        d = a - c
                        mean_p = _fma(centre, mass, a)
                        mean_t = _fma(centre, mass, c)
                        spread = scratch[mixed + _TWO * stride + j] - _fma(a, a, c * c)
                        spread = _fma(two * missing, a + mean_t, spread)
                        inverse1 = one / (_fma(mean_p, mean_p, mean_t * mean_t) + c1)
                        inverse2 = one / (spread + c2)
                        loss1 = d * d * inverse1
                        loss2 = _fma(-d, d, scratch[mixed + _THREE * stride + j]) * inverse2
                        s1, s2 = one - loss1, one - loss2
                        by_sum = s1 * loss2 * inverse2
                        by_difference = -s1 * inverse2
                        by_mean = s2 * inverse1 * _fma(mean_p, loss1, -d)
                        by_mean = two * (by_mean + _fma(missing - a, by_sum, -d * by_difference))
                        scratch[mixed + j] = counts * by_mean
                        scratch[mixed + stride + j] = counts * by_sum
                        scratch[mixed + _TWO * stride + j] = counts * by_difference
                        scratch[unlike + j] += counts * _fma(-loss1, loss2, loss1 + loss2)
                    for q in range(_THREE):
                        for j in range(count):
                            maps[q, y, left + j] = scratch[mixed + q * stride + j]
                    if with_l1:
                        _repeat(scratch, share, weight, True, y, left, count, step)
                        middle = at + reach * stride + halo
                        for j in range(count):
                            distance = abs(scratch[middle + j] - scratch[plane + middle + j])
                            scratch[absolute + j] += scratch[share + j] * distance
                for j in range(count):
                    sum_unlike += scratch[unlike + j]
                    sum_l1 += scratch[absolute + j]
            sums[b, 0] = sum_unlike
            sums[b, 1] = sum_l1

    @cached
    @njit(error_model="numpy", parallel=PRANGE)
    def backward(p, t, weight, taps_weights, centre, with_l1, maps, scale, scale_l1, gradient):
        """Fill gradient (H, W C): scale times the derivative of sum S, plus scale_l1 times that of sum weight |p - t|.

        maps: as `forward` left them.
        """
        height, width = _u(p.shape[0]), _u(p.shape[1])
        for b in prange((height + band - _ONE) // band):
            # Rows: three staged planes; three after the vertical pass; three after both; L1 weights.
            scratch = np.empty(_THREE * plane + _u(7) * stride, dtype=np.float32)
            column = _THREE * plane
            mixed = column + _THREE * stride
            share = mixed + _THREE * stride
            top = _u(b) * band
            bottom = min(top + band, height)
            for left in range(_ZERO, width, tile):
                count = min(tile, width - left)
                padded = count + _TWO * halo
                for q in range(_THREE):
                    for r in range(_ZERO, bottom - top + _TWO * reach):
                        y_staged = np.int64(top + r) - np.int64(reach)
                        _stage(scratch, q * plane + r * stride, maps[q], y_staged, left, padded, halo, np.float32(0))
                for r in range(_ZERO, bottom - top):
                    y = top + r
                    for q in range(_THREE):
                        goal = column + q * stride
                        _filter(scratch, q * plane + r * stride, goal, padded, by_row, taps, taps_weights)
                        _filter(scratch, goal, mixed + q * stride, count, in_row, taps, taps_weights)
                    for j in range(count):
                        a = p[y, left + j]
                        d = a - t[y, left + j]
                        g = _fma(scratch[mixed + stride + j], a - centre, scratch[mixed + _TWO * stride + j] * d)
                        gradient[y, left + j] = scale * (scratch[mixed + j] + g + g)
                    if with_l1:
                        _repeat(scratch, share, weight, True, y, left, count, step)
                        for j in range(count):
                            d = p[y, left + j] - t[y, left + j]
                            sign = np.float32(d > np.float32(0)) - np.float32(d < np.float32(0))
                            gradient[y, left + j] += scale_l1 * scratch[share + j] * sign

    return forward, backward
