"""The linear form for discs: along a row a disc is a run of equal weights with soft ends, O(R) a pixel.

The weight S at dx = +-k of a row `dy` from the centre is 1 up to some k, the run, and falls to 0 over a few
pixels more, the soft ends. The run goes into a row of *differences*: its colour is added at its first
pixel and taken away behind its last, and one prefix sum then gives the row. The soft ends are added pixel by
pixel. As the rows `dy` above and below the centre are the same, one row of sums serves two target rows.

Differences and their prefix sum are four lanes of float64 (three colours and the weight), so that highlights
leave no trace in the dark pixels after them: what was added is taken away to within 1e-16 of the highlight. The
soft ends only ever add up and are float32.

S = 1 / (1 + exp(2 alpha (l - R))) with l = hypot(dy, k) is a product away from a table: l and R are both taken
relative to the nearest multiple of `period`, so that no exponential overflows, exp(2 alpha (l - that)) is tabulated
for every (dy, k), and exp(2 alpha (that - R)) is worked out once a source. A soft end is shorter than the period and
so meets at most two multiples, an even and an odd one: the table's sign says which.

The image is cut into tiles of sources, each with sums of its own for the target rows and columns that it reaches, so
that they are independent and their order doesn't matter; `_merge` adds them up in a fixed order. Along a row of
a tile, sources are sorted by how far they reach: those that reach the row `dy` are the first ones, and
eight neighbours have soft ends of nearly the same length, which keeps branches predictable.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.core.lens import AREA_EPSILON
from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import largest8, select8, splat8
from dofbench.runtime.simd_functions import abs8, exp2_fast8, floor8, max8, min8, sqrt8
from dofbench.runtime.simd_memory import load1, load8, store8, store_whole8

from .cpu_double4 import add_product4, add_row4, load4, splat4, splat_at4, store4, store_double8
from .cpu_pack import Geometry
from .op import COLOURS

WAYS = COLOURS + 1  # lanes per pixel
LANES = 8  # number of sources, and of entries of a soft end, that are processed together
TILE = 512  # sources in a row of a tile: so few that its sums and sources stay in the inner caches
SMALL_IMAGE = 1 << 21
# Weights below exp(-40) have no effect in float32, even next to the largest highlight.
LARGEST_EXPONENT = 40.0
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_LIMIT = np.float32(126.0)  # range of exp2_fast8
# A row's plan. Fields of eight sources each: first entry in the table, first places of the left and of the right soft
# end, number of zeros at the end of the first eight entries, number of entries.
_START, _LEFT, _RIGHT, _ZEROS, _COUNT, _PLAN = 0, 8, 16, 24, 32, 40


def _period(band: float, least: float) -> float:
    """Distance of the multiples that radii and distances are taken relative to; exact in float32, as they are."""
    longest = 1.03 * max(2.0 * band, least)  # the length of a soft end, with a margin for rounding
    unit = 2.0 ** (math.floor(math.log2(longest)) - 4)
    return unit * math.ceil(longest / unit)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _table(rows, columns, period, slope):
    """exp(slope (l - nearest multiple of the period)) by (dy, k), flat; negative for odd multiples."""
    table = np.empty((rows, columns), np.float32)
    for dy in prange(rows):
        for k in range(columns):
            distance = math.sqrt(float(dy * dy + k * k))
            multiple = math.floor(distance / period + 0.5)
            value = math.exp(slope * (distance - multiple * period))
            table[dy, k] = -value if multiple % 2 else value
    return table.reshape(-1)


@internal(error_model="numpy")
def _half_width8(square, dy):
    """Half of the chord at `dy` from the centre of eight discs of these squared radii; -1 where there is none."""
    rest = square - dy * dy
    return select8(rest >= _ZERO, floor8(sqrt8(max8(rest, _ZERO))), -_ONE)


@internal(error_model="numpy")
def _soft8(distances, even, odd):
    """S from eight entries of the table and the sources' factors for even and odd multiples of the period."""
    return _ONE / (_ONE + abs8(distances) * select8(distances < _ZERO, odd, even))


@internal(error_model="numpy")
def _reaches(image, radius, sizes):
    """Where the soft end of a source begins and ends, pixels from its centre. image: its three colours."""
    band = np.float32(sizes.usual_band)
    for channel in range(COLOURS):
        if abs(image[channel]) > sizes.bright:
            band = np.float32(sizes.band)
    return radius - band, min(max(radius + band, np.float32(sizes.least)), np.float32(sizes.height + sizes.width))


@internal(error_model="numpy")
def _sort_row(image, signed_radius, sizes, area, period, steepness, inner, outer, evens, odds, places, colours):
    """Sources of one row of a tile, (n, COLOURS) and (n,), farthest reaching first; the others are filled in, flat.

    inner, outer: squared radii where soft ends begin and end. evens, odds: see `_soft8`. places: column in the
    tile. colours: three and 1, times the area term.
    """
    size = signed_radius.size
    ends = np.empty(size, np.float32)
    for x in range(size):
        ends[x] = -_reaches(image[x], abs(signed_radius[x]), sizes)[1]
    order = np.argsort(ends)
    for i in range(size):
        x = order[i]
        radius = abs(signed_radius[x])
        low, high = _reaches(image[x], radius, sizes)
        inner[i] = low * low if low >= _ZERO else -_ONE
        outer[i] = high * high
        places[i] = x
        # The multiple nearest to the inner end, rounded down in a tie; the soft end meets this multiple and the next
        # one.
        multiple = np.floor(max(low, _ZERO) / period + np.float32(0.49))
        here, following = (multiple * period - radius) * steepness, (multiple * period + period - radius) * steepness
        is_odd = multiple - np.float32(2.0) * np.floor(multiple * np.float32(0.5)) > np.float32(0.5)
        evens[i], odds[i] = (following, here) if is_odd else (here, following)
        share = _ONE
        if area:
            share = _ONE / (radius * radius + np.float32(AREA_EPSILON))
        for channel in range(COLOURS):
            colours[i * WAYS + channel] = share * image[x, channel]
        colours[i * WAYS + COLOURS] = share
    for i in range(0, evens.size, LANES):
        store8(evens, i, exp2_fast8(max8(min8(load8(evens, i), _LIMIT), -_LIMIT)))
        store8(odds, i, exp2_fast8(max8(min8(load8(odds, i), _LIMIT), -_LIMIT)))


@internal(error_model="numpy")
def _plan_row(dy, centre, farthest, pad, inner, outer, evens, odds, places, plan, longest, fulls):
    """Plan where runs and soft ends of a row's sources lie at the target row `dy`; returns how many groups of LANES
    reach it.

    centre: the table's entry at (dy, 0). Fills in plan, longest (entries of a group's longest soft end) and fulls
    (the weight inside of each run; a run is at least the pixel itself).
    """
    ways, lanes = np.float32(WAYS), np.float32(LANES)
    groups = 0
    for group in range(0, outer.size, LANES):
        last = min8(_half_width8(load8(outer, group), dy), farthest)
        if largest8(last) < _ZERO:
            break
        core = min8(_half_width8(load8(inner, group), dy), farthest)
        first = max8(core, _ZERO) + _ONE
        count = max8(last - first + _ONE, _ZERO)
        longest[groups] = int(largest8(count))
        place, at = load8(places, group) + pad, groups * _PLAN
        store_whole8(plan, at + _START, first)
        store_whole8(plan, at + _LEFT, (place - first) * ways)
        store_whole8(plan, at + _RIGHT, (place + first) * ways)
        store_whole8(plan, at + _ZEROS, max8(lanes - count, _ZERO))
        store_whole8(plan, at + _COUNT, count)
        full = select8(core >= _ZERO, _ONE, _soft8(centre, load8(evens, group), load8(odds, group)))
        store_double8(fulls, group, select8(last >= _ZERO, full, _ZERO))
        groups += 1
    return groups


def _soft_ends_of(entries):
    """A function that adds both soft ends of LANES sources; the number of entries is fixed, for straight code."""

    @internal(error_model="numpy", forceinline=True)
    def add(softs, weights, colours, group, plan, at):
        for lane in range(LANES):
            left, right = np.int64(plan[at + _LEFT + lane]), np.int64(plan[at + _RIGHT + lane])
            for e in range(entries):
                add_product4(
                    softs, left - e * WAYS, right + e * WAYS, weights, lane * LANES + e, colours, (group + lane) * WAYS
                )

    return add


_add3, _add4, _add5, _add6, _add8 = (_soft_ends_of(entries) for entries in (3, 4, 5, 6, 8))


@internal(error_model="numpy")
def _add_sources(table, entry, groups, evens, odds, colours, plan, longest, fulls, ones, weights, runs, softs):
    """Add a row's sources, as planned, to the row's `runs`, differences, and `softs`. entry: the table's at (dy, 0)."""
    for number in range(groups):
        group, at, most = number * LANES, number * _PLAN, longest[number]
        for lane in range(LANES):
            source = splat_at4(fulls, group + lane) * load4(colours, (group + lane) * WAYS)
            begin, end = np.int64(plan[at + _LEFT + lane]) + WAYS, np.int64(plan[at + _RIGHT + lane])
            store4(runs, begin, load4(runs, begin) + source)
            store4(runs, end, load4(runs, end) - source)
        if most <= LANES:
            for lane in range(LANES):
                soft = _soft8(
                    load8(table, entry + np.int64(plan[at + _START + lane])),
                    splat8(evens[group + lane]),
                    splat8(odds[group + lane]),
                )
                store8(weights, lane * LANES, soft * load8(ones, np.int64(plan[at + _ZEROS + lane])))
            if most <= 3:
                _add3(softs, weights, colours, group, plan, at)
            elif most == 4:
                _add4(softs, weights, colours, group, plan, at)
            elif most == 5:
                _add5(softs, weights, colours, group, plan, at)
            elif most == 6:
                _add6(softs, weights, colours, group, plan, at)
            else:
                _add8(softs, weights, colours, group, plan, at)
            continue
        for lane in range(LANES):  # soft ends at the top and bottom of the discs, where no run is inside
            even, odd = splat8(evens[group + lane]), splat8(odds[group + lane])
            first = entry + np.int64(plan[at + _START + lane])
            left, right = np.int64(plan[at + _LEFT + lane]), np.int64(plan[at + _RIGHT + lane])
            rest = np.int64(plan[at + _COUNT + lane])
            while rest > 0:
                soft = _soft8(load8(table, first), even, odd)
                store8(weights, 0, soft * load8(ones, LANES - min(rest, LANES)))  # type: ignore[operator]  # compiled, both are int64
                for e in range(LANES):
                    add_product4(softs, left - e * WAYS, right + e * WAYS, weights, e, colours, (group + lane) * WAYS)
                rest -= LANES
                first += LANES
                left -= LANES * WAYS
                right += LANES * WAYS


@internal(error_model="numpy")
def _flush(runs, softs, start, first, last, stop, buffer, below, above):
    """Add a row of sums to the buffer, at `below` and `above` unless negative, and make it zero again.

    Elements `start` to `stop` may hold something, `first` to `last` lie inside the image.
    """
    running, zero = splat4(0.0), splat4(0.0)
    for i in range(start, first, WAYS):
        running = running + load4(runs, i)
        store4(runs, i, zero)
        store4(softs, i, zero)
    size = last - first
    if below >= 0 and above >= 0:
        for i in range(0, size, WAYS):
            running = running + load4(runs, first + i)
            store4(runs, first + i, zero)
            add_row4(buffer, below + i, running, softs, first + i)
            add_row4(buffer, above + i, running, softs, first + i)
            store4(softs, first + i, zero)
    else:
        to = max(below, above)
        for i in range(0, size, WAYS):
            running = running + load4(runs, first + i)
            store4(runs, first + i, zero)
            add_row4(buffer, to + i, running, softs, first + i)
            store4(softs, first + i, zero)
    for i in range(last, stop, WAYS):
        store4(runs, i, zero)
        store4(softs, i, zero)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _spread(image, signed_radius, area, table, columns, sizes, rows, tile, step, period, steepness):
    """Sums by tiles of `rows` x `tile` sources, (tiles, rows and columns that they reach * WAYS); see `_merge`."""
    height, width, reach_y, reach_x = sizes.height, sizes.width, sizes.reach_y, sizes.reach_x
    pad = reach_x + 3 + 2 * LANES
    down, across = -(-height // rows), -(-width // tile)
    wide, tall = min(width, tile + 2 * reach_x), min(height, rows + 2 * reach_y)
    buffers = np.empty((down * across, tall * wide * WAYS), np.float32)
    ones = np.zeros(2 * LANES, np.float32)
    ones[:LANES] = 1
    for task in prange(down * across):
        # Threads take neighbouring tasks. Neighbouring tiles take similar times, so they are assigned to different
        # threads.
        number = task * step % (down * across)
        buffer = buffers[number]
        buffer[:] = 0
        top, first = number // across * rows, number % across * tile
        bottom, last = min(height, top + rows), min(width, first + tile)
        row0, column0 = max(0, top - reach_y), max(0, first - reach_x)
        size = LANES * -(-(last - first) // LANES)
        runs, softs = (
            np.zeros((last - first + 2 * pad) * WAYS, np.float64),
            np.zeros((last - first + 2 * pad) * WAYS, np.float32),
        )
        inner, outer, places = np.full(size, -_ONE), np.full(size, -_ONE), np.zeros(size, np.float32)
        evens, odds, colours = np.zeros(size, np.float32), np.zeros(size, np.float32), np.zeros(size * WAYS, np.float32)
        plan, longest = np.empty(size // LANES * _PLAN, np.int32), np.empty(size // LANES, np.int64)
        fulls, weights = np.empty(size, np.float64), np.empty(LANES * LANES, np.float32)
        for y in range(top, bottom):
            _sort_row(
                image[y, first:last], signed_radius[y, first:last], sizes, area, period, steepness, inner, outer, evens,
                odds, places, colours,
            )  # fmt: skip
            for dy in range(reach_y + 1):
                below, above = y + dy < height, dy > 0 and y - dy >= 0
                rest = outer[0] - np.float32(dy) * np.float32(dy)
                if rest < _ZERO or not (below or above):
                    break
                entry = dy * columns
                groups = _plan_row(
                    np.float32(dy), splat8(load1(table, entry)), np.float32(reach_x), np.float32(pad), inner, outer,
                    evens, odds, places, plan, longest, fulls,
                )  # fmt: skip
                _add_sources(
                    table, entry, groups, evens, odds, colours, plan, longest, fulls, ones, weights, runs, softs
                )
                chord = min(reach_x, int(np.sqrt(rest))) + 1
                left, right = max(0, first - chord), min(width, last + chord)
                to = (y - row0) * wide + left - column0
                _flush(
                    runs, softs, (pad - chord - LANES) * WAYS, (pad + left - first) * WAYS,
                    (pad + right - first) * WAYS, (pad + last - first + chord + LANES) * WAYS, buffer,
                    (to + dy * wide) * WAYS if below else -1, (to - dy * wide) * WAYS if above else -1,
                )  # fmt: skip
    return buffers


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _merge(buffers, height, width, rows, tile, reach_y, reach_x):
    """Sum the buffers that cover each row, in order, and divide: blurred (H, W, COLOURS), total (H, W)."""
    blurred = np.empty((height, width, COLOURS), np.float32)
    total = np.empty((height, width), np.float32)
    down, across, wide = -(-height // rows), -(-width // tile), min(width, tile + 2 * reach_x)
    for y in prange(height):
        line = np.zeros(width * WAYS, np.float32)
        for band in range(max(0, (y - reach_y) // rows), min(down - 1, (y + reach_y) // rows) + 1):
            at = (y - max(0, band * rows - reach_y)) * wide * WAYS
            for part in range(across):
                left, right = max(0, part * tile - reach_x), min(width, part * tile + tile + reach_x)
                line[left * WAYS : right * WAYS] += buffers[band * across + part, at : at + (right - left) * WAYS]
        for x in range(width):
            total[y, x] = line[x * WAYS + COLOURS]
            for channel in range(COLOURS):
                blurred[y, x, channel] = line[x * WAYS + channel] / total[y, x]
    return blurred, total


def _tiles(sizes: Geometry) -> tuple[int, int, int]:
    """Rows and columns of a tile, and a step by which all tiles are visited once, with no neighbours in succession."""
    # With tiles as large as their sources' reach, `_merge` adds at most four times the image's pixels; small images get
    # smaller tiles, so that every core has work.
    across = -(-sizes.width // max(TILE, 2 * sizes.reach_x))
    down = -(-sizes.height // max(TILE, 2 * sizes.reach_y))
    if sizes.height * sizes.width < SMALL_IMAGE:
        down = max(down, min(8, -(-sizes.height // 32)))
    rows, tile = -(-sizes.height // down), LANES * -(-sizes.width // (LANES * across))
    tiles = -(-sizes.height // rows) * -(-sizes.width // tile)
    step = max(1, round(0.618 * tiles))
    while math.gcd(step, tiles) > 1:
        step += 1
    return rows, tile, step


def forward(
    image: np.ndarray, signed_radius: np.ndarray, sizes: Geometry, alpha: float, area: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Blurred colours (H, W, COLOURS) and total weight (H, W)."""
    farthest = LARGEST_EXPONENT / (2.0 * alpha)
    sizes = sizes._replace(band=min(sizes.band, farthest), usual_band=min(sizes.usual_band, farthest))
    period = _period(sizes.band, sizes.least)
    columns = sizes.reach_x + 2 + 2 * LANES
    table = _table(sizes.reach_y + 1, columns, period, 2.0 * alpha)
    rows, tile, step = _tiles(sizes)
    buffers = _spread(
        image, signed_radius, area, table, columns, sizes, rows, tile, step, np.float32(period),
        np.float32(2.0 * alpha * math.log2(math.e)),
    )  # fmt: skip
    return _merge(buffers, sizes.height, sizes.width, rows, tile, sizes.reach_y, sizes.reach_x)
