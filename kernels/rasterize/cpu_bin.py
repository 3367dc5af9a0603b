"""Assigns Gaussians to tiles: the tiles that each Gaussian meets, and each tile's Gaussians in order of depth."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, bits8, lanes8, splat8
from dofbench.runtime.simd_functions import floor8, floor_int, max8, min8, sqrt8
from dofbench.runtime.simd_memory import load1, store8

from . import cpu_layout as layout

# Bounds are widened by this, so that rounding never leaves out a pixel that blending would use. It is added to the
# base-2 exponent, and to positions in pixels.
_SLACK = np.float32(1e-3)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_TILE_WIDTH = np.float32(layout.TILE_WIDTH)
_TILE_HEIGHT = np.float32(layout.TILE_HEIGHT)


@internal(forceinline=True, error_model="numpy")
def ellipse_box(records, i, view):
    """The tiles around the ellipse where the Gaussian counts: first column, first row, columns, rows (0 if outside)."""
    base = i * layout.RECORD
    mx, my = load1(records, base + layout.MX), load1(records, base + layout.MY)
    l11, l21 = load1(records, base + layout.L11), load1(records, base + layout.L21)
    l22 = load1(records, base + layout.L22)
    reach = math.sqrt(load1(records, base + layout.LOG2_OPACITY) - load1(records, base + layout.LIMIT) + _SLACK)
    half_y = reach / l22 + _SLACK
    half_x = half_y * math.sqrt(l21 * l21 + l22 * l22) / l11 + _SLACK
    left = max(-floor_int(half_x + _HALF - mx), 0)
    right = min(floor_int(mx + half_x - _HALF), np.int64(view[layout.WIDTH]) - 1)
    top = max(-floor_int(half_y + _HALF - my), 0)
    bottom = min(floor_int(my + half_y - _HALF), np.int64(view[layout.HEIGHT]) - 1)
    if right < left or bottom < top:
        return 0, 0, 0, 0
    column, row = left // layout.TILE_WIDTH, top // layout.TILE_HEIGHT
    return column, row, right // layout.TILE_WIDTH - column + 1, bottom // layout.TILE_HEIGHT - row + 1


@internal(forceinline=True, error_model="numpy")
def ellipse_rows(records, i, view, column, row, columns, cell):
    """For eight tiles of the box, the pixel rows that the ellipse reaches within each tile: first row, and one past the
    last.

    The tiles are numbers cell … cell + 7 of the box, row by row. The ellipse is
    (l11 dx + l21 dy)**2 + (l22 dy)**2 <= reach2. Its lower and upper sides are, with n = l21**2 + l22**2,
    dy = (-l11 l21 dx -+ sqrt(n reach2 - (l11 l22 dx)**2)) / n, a convex and a concave function of dx whose
    extremes lie at dx = +- l21 sqrt(reach2) / (l11 l22): so over a tile's columns the extreme is at the dx nearest to
    this one.
    """
    base = i * layout.RECORD
    mx, my = load1(records, base + layout.MX), load1(records, base + layout.MY)
    l11, l21 = load1(records, base + layout.L11), load1(records, base + layout.L21)
    l22 = load1(records, base + layout.L22)
    reach2 = load1(records, base + layout.LOG2_OPACITY) - load1(records, base + layout.LIMIT) + _SLACK
    n = l21 * l21 + l22 * l22
    reach = math.sqrt(reach2)
    widest = reach * math.sqrt(n) / (l11 * l22)
    highest = -l21 * reach / (l11 * l22)
    inverse = _ONE / n

    number = lanes8() + np.float32(cell)
    down = floor8((number + _HALF) * (_ONE / np.float32(columns)))
    across = number - down * np.float32(columns)
    left = (across + np.float32(column)) * _TILE_WIDTH + (_HALF - mx - _SLACK)
    top = (down + np.float32(row)) * _TILE_HEIGHT
    low = max8(left, -widest)
    high = min8(left + (_TILE_WIDTH - _ONE + _SLACK + _SLACK), widest)
    at = min8(max8(splat8(highest), low), high)
    last = (sqrt8(max8(n * reach2 - (l11 * l22 * at) * (l11 * l22 * at), _ZERO)) - l11 * l21 * at) * inverse
    at = min8(max8(splat8(-highest), low), high)
    first = (-sqrt8(max8(n * reach2 - (l11 * l22 * at) * (l11 * l22 * at), _ZERO)) - l11 * l21 * at) * inverse
    first = max8(-floor8(-(first + (my - _HALF - _SLACK) - top)), _ZERO)
    bottom = min8(view[layout.HEIGHT] - top, _TILE_HEIGHT)
    stop = min8(floor8(last + (my - _HALF + _SLACK) - top) + _ONE, bottom)
    met = (low <= high) & (first < stop)
    return first, stop, met


@internal(error_model="numpy")
def count_tiles(records, i, view):
    """The number of tiles that Gaussian i meets."""
    column, row, columns, rows = ellipse_box(records, i, view)
    cells = columns * rows
    total = 0
    for cell in range(0, cells, LANES):
        _, _, met = ellipse_rows(records, i, view, column, row, columns, cell)
        bits = bits8(met)
        if cells - cell < LANES:
            bits &= (1 << (cells - cell)) - 1
        while bits != 0:
            bits &= bits - 1
            total += 1
    return total


@internal(error_model="numpy")
def list_tiles(records, i, view, tiles_across, slot, tiles, spans, buffer):
    """Write the tiles that Gaussian i meets to `tiles`, and their rows as first | stop << 8 to `spans`."""
    column, row, columns, rows = ellipse_box(records, i, view)
    cells = columns * rows
    x, y = column, row
    for cell in range(0, cells, LANES):
        first, stop, met = ellipse_rows(records, i, view, column, row, columns, cell)
        bits = bits8(met)
        store8(buffer, 0, first)
        store8(buffer, LANES, stop)
        for lane in range(min(LANES, cells - cell)):
            if bits >> lane & 1:
                tiles[slot] = y * tiles_across + x
                spans[slot] = np.int64(buffer[lane]) | np.int64(buffer[LANES + lane]) << 8
                slot += 1
            x += 1
            if x == column + columns:
                x, y = column, y + 1
    return slot


@cached
@njit(error_model="numpy")
def depth_order(depths, counts, n):
    """Indices of the Gaussians that meet a tile, nearest first, equal depths in index order (int32).

    A radix sort on the bits of the depths, which for positive floats are in the floats' order.
    """
    bits = depths.view(np.uint32)
    visible = 0
    low, high = np.uint32(0xFFFFFFFF), np.uint32(0)
    for i in range(n):
        if counts[i] > 0:
            visible += 1
            low, high = min(low, bits[i]), max(high, bits[i])
    keys, order = np.empty(visible, np.uint32), np.empty(visible, np.int32)
    k = 0
    for i in range(n):
        if counts[i] > 0:
            keys[k], order[k] = bits[i] - low, i
            k += 1
    if visible == 0:
        return order
    other_keys, other_order = np.empty_like(keys), np.empty_like(order)
    span = np.int64(high - low)
    shift = 0
    while (span >> shift) > 0:
        starts = np.zeros(2049, np.int64)
        for k in range(visible):
            starts[((keys[k] >> np.uint32(shift)) & np.uint32(2047)) + np.uint32(1)] += 1
        for digit in range(2048):
            starts[digit + 1] += starts[digit]
        for k in range(visible):
            digit = (keys[k] >> np.uint32(shift)) & np.uint32(2047)
            place = starts[digit]
            starts[digit] = place + 1
            other_keys[place], other_order[place] = keys[k], order[k]
        keys, other_keys = other_keys, keys
        order, other_order = other_order, order
        shift += 11
    return order


@cached
@njit(parallel=PRANGE, error_model="numpy")
def fill_tiles(records, counts, n, order, view, columns, rows, chunks):
    """Every tile's list of Gaussians, nearest first.

    Returns starts (tiles + 1,), ids and spans (intersections,), offsets (n + 1,) and places (intersections,).
    Tile t's list are the places starts[t] … starts[t + 1] of ids and spans: the Gaussian's index, and the tile's rows
    it reaches as first | stop << 8. places[offsets[i] : offsets[i + 1]] are the places of Gaussian i, in the order
    of the tiles. `chunks` is the number of parts processed in parallel; the result doesn't depend on it.
    """
    offsets = np.empty(n + 1, np.int32)
    total = 0
    for i in range(n):
        offsets[i] = total
        total += counts[i]
    offsets[n] = total

    slot_tiles, slot_spans = np.empty(total, np.int32), np.empty(total, np.int16)
    for chunk in prange(chunks):
        buffer = np.empty(2 * LANES, np.float32)
        for i in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            if counts[i] > 0:
                list_tiles(records, i, view, columns, np.int64(offsets[i]), slot_tiles, slot_spans, buffer)

    tiles = columns * rows
    cursors = np.zeros((chunks, tiles), np.int32)
    for chunk in prange(chunks):
        for k in range(chunk * order.size // chunks, (chunk + 1) * order.size // chunks):
            gaussian = np.int64(order[k])
            for slot in range(np.int64(offsets[gaussian]), np.int64(offsets[gaussian + 1])):
                cursors[chunk, slot_tiles[slot]] += 1

    starts = np.empty(tiles + 1, np.int32)
    place = 0
    for tile in range(tiles):
        starts[tile] = place
        for chunk in range(chunks):
            met = cursors[chunk, tile]
            cursors[chunk, tile] = place
            place += met
    starts[tiles] = place

    ids, spans, places = np.empty(total, np.int32), np.empty(total, np.int16), np.empty(total, np.int32)
    for chunk in prange(chunks):
        for k in range(chunk * order.size // chunks, (chunk + 1) * order.size // chunks):
            gaussian = np.int64(order[k])
            for slot in range(np.int64(offsets[gaussian]), np.int64(offsets[gaussian + 1])):
                tile = slot_tiles[slot]
                place = cursors[chunk, tile]
                cursors[chunk, tile] = place + 1
                ids[place], spans[place], places[slot] = gaussian, slot_spans[slot], place
    return starts, ids, spans, offsets, places
