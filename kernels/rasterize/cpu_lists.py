"""Every tile's list of Gaussians, nearest first.

The Gaussians are dealt to their tiles in the order of their indices, which reads memory in order, and then each tile's
list is sorted by depth within the caches: sorting all Gaussians first, and dealing them in the order of depth, read
memory at random and took four times as long with a million Gaussians.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES

from .cpu_bin import list_tiles

_DIGIT = np.uint64(8)  # bits that one pass of the radix sort looks at
_DIGITS = 1 << 8
_LAST = np.uint64(_DIGITS - 1)
_DEPTH = np.uint64(32)  # where the depth's bits begin in a key
_FEW = 40  # entries up to which a sort by insertion is faster


@internal(error_model="numpy")
def sort_keys(keys, other, count):
    """Sort `count` keys by their upper halves, equal ones staying in their order; returns the array, of the two given,
    that has them."""
    if count <= _FEW:
        for k in range(1, count):
            key = keys[k]
            place = k
            while place > 0 and keys[place - 1] >> _DEPTH > key >> _DEPTH:
                keys[place] = keys[place - 1]
                place -= 1
            keys[place] = key
        return keys
    low, high = keys[0] >> _DEPTH, keys[0] >> _DEPTH
    for k in range(1, count):
        low, high = min(low, keys[k] >> _DEPTH), max(high, keys[k] >> _DEPTH)
    span, shift = high - low, np.uint64(0)
    starts = np.empty(_DIGITS, np.int64)
    while (span >> shift) > np.uint64(0):
        starts[:] = 0
        for k in range(count):
            starts[(((keys[k] >> _DEPTH) - low) >> shift) & _LAST] += 1
        before = 0
        for digit in range(_DIGITS):
            starts[digit], before = before, before + starts[digit]
        for k in range(count):
            digit = (((keys[k] >> _DEPTH) - low) >> shift) & _LAST
            other[starts[digit]] = keys[k]
            starts[digit] += 1
        keys, other = other, keys
        shift += _DIGIT
    return keys


@cached
@njit(parallel=PRANGE, error_model="numpy")
def fill_tiles(records, depths, counts, n, view, columns, rows, chunks):
    """Every tile's list of Gaussians, nearest first, equal depths in the order of indices.

    Returns starts (tiles + 1,), ids and spans (intersections,), offsets (n + 1,) and places (intersections,).
    Tile t's list are the places starts[t] … starts[t + 1] of ids and spans: the Gaussian's index, and the tile's rows
    it reaches as first | stop << 8. places[offsets[i] : offsets[i + 1]] are the places of Gaussian i, in the order
    of the tiles. depths: positive. `chunks` is the number of parts processed in parallel; the result doesn't depend on
    it.
    """
    offsets = np.empty(n + 1, np.int32)
    sums = np.zeros(chunks + 1, np.int64)
    for chunk in prange(chunks):
        part = 0
        for i in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            part += counts[i]
        sums[chunk + 1] = part
    for chunk in range(chunks):
        sums[chunk + 1] += sums[chunk]
    total = sums[chunks]
    offsets[n] = total

    tiles = columns * rows
    slot_ids, slot_tiles, slot_spans = np.empty(total, np.int32), np.empty(total, np.int32), np.empty(total, np.int16)
    cursors = np.zeros((chunks, tiles), np.int32)
    for chunk in prange(chunks):
        buffer = np.empty(2 * LANES, np.float32)
        slot = sums[chunk]
        for i in range(chunk * n // chunks, (chunk + 1) * n // chunks):
            offsets[i] = slot
            if counts[i] > 0:
                stop = list_tiles(records, i, view, columns, slot, slot_tiles, slot_spans, buffer)
                for k in range(slot, stop):
                    slot_ids[k] = i
                    cursors[chunk, slot_tiles[k]] += 1
                slot = stop

    starts = np.empty(tiles + 1, np.int32)
    place = 0
    for tile in range(tiles):
        starts[tile] = place
        for chunk in range(chunks):
            met = cursors[chunk, tile]
            cursors[chunk, tile] = place
            place += met
    starts[tiles] = place

    # A key: the depth's bits, which for positive floats are in the floats' order, and the intersection's number.
    bits, keys = depths.view(np.uint32), np.empty(total, np.uint64)
    for chunk in prange(chunks):
        for slot in range(sums[chunk], sums[chunk + 1]):
            tile = slot_tiles[slot]
            place = cursors[chunk, tile]
            cursors[chunk, tile] = place + 1
            keys[place] = np.uint64(bits[slot_ids[slot]]) << _DEPTH | np.uint64(slot)

    ids, spans, places = np.empty(total, np.int32), np.empty(total, np.int16), np.empty(total, np.int32)
    longest = np.int64(0)
    for tile in range(tiles):
        longest = max(longest, np.int64(starts[tile + 1] - starts[tile]))
    for chunk in prange(chunks):
        other = np.empty(longest, np.uint64)
        for tile in range(chunk, tiles, chunks):
            begin, stop = np.int64(starts[tile]), np.int64(starts[tile + 1])
            found = sort_keys(keys[begin:stop], other, stop - begin)
            for k in range(stop - begin):
                slot = np.int64(found[k] & np.uint64(0xFFFFFFFF))
                ids[begin + k], spans[begin + k], places[slot] = slot_ids[slot], slot_spans[slot], begin + k
    return starts, ids, spans, offsets, places
