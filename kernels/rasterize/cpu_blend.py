"""Blending the tiles' Gaussians front to back, and its gradient, eight pixels of a row at a time."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, any8, lanes8, select8, splat8, sums8
from dofbench.runtime.simd_functions import abs8, exp2_fast8, max8, min8
from dofbench.runtime.simd_memory import load1, load8, prefetch, store8

from . import cpu_layout as layout
from . import cpu_tiles as planes
from .cpu_tiles import clear_tile, read_tile, write_tile

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_MINUS_TWO = np.float32(-2.0)
_TWO_LN2 = np.float32(2 * math.log(2))

# After so many Gaussians it is tested whether the whole tile is opaque.
_TEST_EVERY = 8
# Records are prefetched so many Gaussians ahead, because they are scattered over more memory than the inner caches
# hold.
_AHEAD = 8


@internal(forceinline=True)
def _load3(array, index):
    return load1(array, index), load1(array, index + 1), load1(array, index + 2)


@internal(forceinline=True)
def _is_opaque(scratch):
    highest = splat8(_ZERO)
    for k in range(0, planes.PLANE, LANES):
        highest = max8(load8(scratch, planes.T + k), highest)
    return not any8(highest >= layout.MIN_TRANSMITTANCE)


@internal(error_model="numpy")
def _forward_tile(features, records, ids, spans, begin, end, left, top, near, scratch):
    """Blend one tile into `scratch`; returns how many of its Gaussians were processed before it was opaque."""
    for k in range(begin, end):
        base = np.int64(ids[k]) * layout.RECORD
        prefetch(records, np.int64(ids[min(k + _AHEAD, end - 1)]) * layout.RECORD)
        first, stop = np.int64(spans[k]) & 255, np.int64(spans[k]) >> 8
        l11, l21, l22 = _load3(records, base + layout.L11)
        log2_opacity, limit = load1(records, base + layout.LOG2_OPACITY), load1(records, base + layout.LIMIT)
        red, green, blue = _load3(records, base + layout.RED)
        my = load1(records, base + layout.MY)
        dx = lanes8() + (np.float32(left) + _HALF - load1(records, base + layout.MX))
        ldx = dx * l11
        if len(features) > 0:
            t0, tx, ty = _load3(records, base + layout.T0)
            t_row = t0 - dx * tx
        dy = np.float32(top + first) + (_HALF - my)
        for row in range(first, stop):
            place = row * LANES
            e = l22 * dy
            d = ldx + l21 * dy
            exponent = (log2_opacity - e * e) - d * d
            transmittance = load8(scratch, planes.T + place)
            taken = (exponent >= limit) & (transmittance >= layout.MIN_TRANSMITTANCE)
            alpha = select8(taken, min8(exp2_fast8(exponent), layout.MAX_ALPHA), _ZERO)
            weight = alpha * transmittance
            store8(scratch, planes.T + place, transmittance - weight)
            store8(scratch, planes.RED + place, load8(scratch, planes.RED + place) + weight * red)
            store8(scratch, planes.GREEN + place, load8(scratch, planes.GREEN + place) + weight * green)
            store8(scratch, planes.BLUE + place, load8(scratch, planes.BLUE + place) + weight * blue)
            if len(features) > 0:
                t = max8(t_row - ty * dy, near)
                store8(scratch, planes.DEPTH + place, load8(scratch, planes.DEPTH + place) + weight * t)
                before = load8(scratch, planes.WEIGHT + place)
                store8(scratch, planes.WEIGHT + place, before + weight)
                if len(features) > 1:
                    nx, ny, nz = _load3(records, base + layout.NX)
                    store8(scratch, planes.NX + place, load8(scratch, planes.NX + place) + weight * nx)
                    store8(scratch, planes.NY + place, load8(scratch, planes.NY + place) + weight * ny)
                    store8(scratch, planes.NZ + place, load8(scratch, planes.NZ + place) + weight * nz)
                    upper = taken & (transmittance > _HALF)
                    store8(scratch, planes.MEDIAN + place, select8(upper, t, load8(scratch, planes.MEDIAN + place)))
                    at = select8(upper, np.float32(k - begin + 1), load8(scratch, planes.MEDIAN_AT + place))
                    store8(scratch, planes.MEDIAN_AT + place, at)
                    if len(features) > 2:
                        inverse = _ONE / t
                        origin = select8(taken & (before == _ZERO), inverse, load8(scratch, planes.FIRST + place))
                        store8(scratch, planes.FIRST + place, origin)
                        m1 = weight * (inverse - origin)
                        store8(scratch, planes.M1 + place, load8(scratch, planes.M1 + place) + m1)
                        m2 = m1 * (inverse - origin)
                        store8(scratch, planes.M2 + place, load8(scratch, planes.M2 + place) + m2)
            dy += _ONE
        if (k - begin) % _TEST_EVERY == _TEST_EVERY - 1 and _is_opaque(scratch):
            return k + 1 - begin
    return end - begin


@internal(error_model="numpy")
def _backward_tile(
    features, absolute, width, records, ids, spans, begin, end, looked_at, left, top, near, scratch, out, blended
):
    """One tile's contribution to the gradient, written to `out` at each intersection's place (`width` floats)."""
    zero = splat8(_ZERO)
    for k in range(begin, begin + looked_at):
        base = np.int64(ids[k]) * layout.RECORD
        prefetch(records, np.int64(ids[min(k + _AHEAD, end - 1)]) * layout.RECORD)
        first, stop = np.int64(spans[k]) & 255, np.int64(spans[k]) >> 8
        l11, l21, l22 = _load3(records, base + layout.L11)
        log2_opacity, limit = load1(records, base + layout.LOG2_OPACITY), load1(records, base + layout.LIMIT)
        red, green, blue = _load3(records, base + layout.RED)
        my = load1(records, base + layout.MY)
        dx = lanes8() + (np.float32(left) + _HALF - load1(records, base + layout.MX))
        ldx = dx * l11
        if len(features) > 0:
            t0, tx, ty = _load3(records, base + layout.T0)
            t_row = t0 - dx * tx
            if len(features) > 1:
                nx, ny, nz = _load3(records, base + layout.NX)
        # Sums over the rows, lane by lane. dx is constant within a lane, so moments in dx are computed after the rows.
        q0, q1, q2 = zero, zero, zero
        sum_red, sum_green, sum_blue = zero, zero, zero
        sum_t, sum_ty, sum_nx, sum_ny, sum_nz = zero, zero, zero, zero, zero
        abs_x, abs_y = zero, zero
        dy = np.float32(top + first) + (_HALF - my)
        for row in range(first, stop):
            place = row * LANES
            e = l22 * dy
            d = ldx + l21 * dy
            exponent = (log2_opacity - e * e) - d * d
            transmittance = load8(scratch, planes.T + place)
            taken = (exponent >= limit) & (transmittance >= layout.MIN_TRANSMITTANCE)
            alpha = select8(taken, min8(exp2_fast8(exponent), layout.MAX_ALPHA), _ZERO)
            weight = alpha * transmittance
            store8(scratch, planes.T + place, transmittance - weight)
            g_red, g_green = load8(scratch, planes.RED + place), load8(scratch, planes.GREEN + place)
            g_blue = load8(scratch, planes.BLUE + place)
            s = load8(scratch, planes.G_ALPHA + place) + g_red * red + g_green * green + g_blue * blue
            sum_red += weight * g_red
            sum_green += weight * g_green
            sum_blue += weight * g_blue
            if len(features) > 0:
                t = t_row - ty * dy
                held = max8(t, near)
                g_depth = load8(scratch, planes.G_DEPTH + place)
                s += g_depth * held
                g_t = weight * g_depth
                if len(features) > 1:
                    at = load8(scratch, planes.MEDIAN_AT + place) == np.float32(k - begin + 1)
                    g_t += select8(at, load8(scratch, planes.G_MEDIAN + place), _ZERO)
                    g_nx, g_ny = load8(scratch, planes.G_NX + place), load8(scratch, planes.G_NY + place)
                    g_nz = load8(scratch, planes.G_NZ + place)
                    s += g_nx * nx + g_ny * ny + g_nz * nz
                    sum_nx += weight * g_nx
                    sum_ny += weight * g_ny
                    sum_nz += weight * g_nz
                    if len(features) > 2:
                        inverse, g_spread = _ONE / held, load8(scratch, planes.G_SPREAD + place)
                        apart = inverse - load8(scratch, planes.MEAN + place)
                        s += g_spread * apart * apart
                        g_t += weight * g_spread * apart * inverse * inverse * _MINUS_TWO
                g_t = select8(t > near, g_t, _ZERO)
                sum_t += g_t
                sum_ty += g_t * dy
            rest = load8(scratch, planes.LEFT + place) - weight * s
            store8(scratch, planes.LEFT + place, rest)
            by_alpha = transmittance * s - rest / (_ONE - alpha)
            q = select8(exponent < layout.LOG2_MAX_ALPHA, by_alpha * alpha, _ZERO)
            q0 += q
            q1 += q * dy
            q2 += q * dy * dy
            if len(absolute) > 0:
                g_x, g_y = q * (_TWO_LN2 * l11) * d, q * _TWO_LN2 * (d * l21 + l22 * e)
                if len(features) > 0:
                    g_x += g_t * tx
                    g_y += g_t * ty
                abs_x += abs8(g_x)
                abs_y += abs8(g_y)
            dy += _ONE
        low = sums8(q0, q0 * dx, q0 * dx * dx, q1, q1 * dx, q2, sum_red, sum_green)
        middle = sums8(sum_blue, sum_t, sum_t * dx, sum_ty, abs_x, abs_y, sum_nx, sum_ny)
        if len(features) > 1:
            high = sums8(sum_nz, zero, zero, zero, zero, zero, zero, zero)
        blended[k] = 1
        place = np.int64(k) * width
        store8(out, place, low)
        store8(out, place + LANES, middle)
        if len(features) > 1:
            store8(out, place + 2 * LANES, high)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def blend(features, records, lists, view, columns, background, images, looked_at, workers):
    """Composite every tile, writing the images (flat) and how many Gaussians each tile processed.

    features: an empty tuple for colour and alpha, one entry to add depth, two to add median depth and normals, three
    to add distortion (its length is known when compiling). lists: starts, ids and spans of `fill_tiles`. images: color,
    alpha, depth, median, median_at, normal, distortion, mean_inverse; those that the features skip may be empty.
    mean_inverse: the mean of the inverse ray lengths, which the backward pass needs for distortion.
    """
    starts, ids, spans = lists
    tiles = looked_at.size
    for worker in prange(workers):
        scratch = np.empty(planes.SCRATCH_WITH_DISTORTION if len(features) > 2 else planes.SCRATCH, np.float32)
        # Neighbouring tiles take similar times, so assigning tiles to workers in turn balances the work.
        for tile in range(worker, tiles, workers):
            left, top = tile % columns * layout.TILE_WIDTH, tile // columns * layout.TILE_HEIGHT
            clear_tile(scratch, left, top, view)
            looked_at[tile] = _forward_tile(
                features, records, ids, spans, starts[tile], starts[tile + 1], left, top, view[layout.NEAR], scratch
            )
            write_tile(features, scratch, left, top, view, background, images)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def blend_backward(
    features, absolute, records, lists, view, columns, looked_at, images, by_images, out, blended, workers
):  # fmt: skip
    """The contribution of every intersection that was blended to the gradient, written to its place in `out` (see
    cpu_layout); sets its element of `blended` to 1.

    absolute: a tuple with one entry to fill ABS_X and ABS_Y too, else empty. by_images: the gradients with respect to
    color, alpha, depth, median, normal and distortion; one of size 0 is zero. The other arguments are those of `blend`.
    """
    starts, ids, spans = lists
    tiles = looked_at.size
    width = 24 if len(features) > 1 else 16
    for worker in prange(workers):
        scratch = np.empty(planes.SCRATCH_WITH_DISTORTION if len(features) > 2 else planes.SCRATCH, np.float32)
        for tile in range(worker, tiles, workers):
            left, top = tile % columns * layout.TILE_WIDTH, tile // columns * layout.TILE_HEIGHT
            if looked_at[tile] > 0:
                read_tile(features, scratch, left, top, view, images, by_images)
            _backward_tile(
                features, absolute, width, records, ids, spans, starts[tile], starts[tile + 1],
                looked_at[tile], left, top, view[layout.NEAR], scratch, out, blended,
            )  # fmt: skip
