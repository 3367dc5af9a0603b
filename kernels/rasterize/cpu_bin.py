"""The tiles that a Gaussian meets, and the rows of each that it reaches."""

from __future__ import annotations

import math

import numpy as np

from dofbench.runtime.kernel_cache import internal
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
