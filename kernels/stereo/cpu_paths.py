"""The semiglobal paths of `cpu.py`, eight planes at a time.

Rows run in parallel, and then groups of columns that are adjacent in memory; each task writes to separate places.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, bits8, lanes8, largest8, select8, splat8
from dofbench.runtime.simd_functions import abs8, min8
from dofbench.runtime.simd_memory import load8, store8

from .op import FAR

COLUMNS = 16  # columns per task of the vertical paths
_F = np.float32
_ZERO, _ONE, _HALF, _INFINITY = _F(0), _F(1), _F(0.5), _F(np.inf)


@internal(error_model="numpy")
def _step(before, after, lowest, scores, first, count, small, jump, total, at, add):
    """One step along a path, from the costs `before` of a pixel to the costs `after` of the next; returns the least of
    these.

    Costs have LANES of infinity at both ends. total[at : at + count] becomes the cost, or has it added.
    """
    highest, least = lowest + jump, splat8(_INFINITY)
    for k in range(0, count, LANES):
        way = min8(load8(before, k + LANES - 1), load8(before, k + LANES + 1)) + small
        way = min8(min8(way, load8(before, k + LANES)), highest)
        cost = way - lowest - load8(scores, first + k)
        store8(after, k + LANES, cost)
        least = min8(cost, least)
        store8(total, at + k, cost + load8(total, at + k) if add else cost)
    return -largest8(-least)


@internal(error_model="numpy")
def _begin(before, after, count):
    """Initial costs, from which `_step` with `lowest` 0 computes the costs of a path's first pixel."""
    before[:] = _INFINITY
    after[:] = _INFINITY
    before[LANES : LANES + count] = _ZERO


@internal(error_model="numpy")
def _jump(guide, at, other, small, large, edge):
    value = large / (_ONE + abs(guide[at] - guide[other]) / edge)
    return value if value > small else small


@cached
@njit(parallel=PRANGE, error_model="numpy")
def along_rows(scores, guide, shape, small, large, edge, left, right, total):
    """Fill total (H, right - left, D) with the costs of both horizontal paths. Arrays are flat, D whole vectors."""
    height, width, count = shape
    for row in prange(height):
        one, two = np.empty(count + 2 * LANES, np.float32), np.empty(count + 2 * LANES, np.float32)
        for forth in (True, False):
            _begin(one, two, count)
            lowest = _ZERO
            for k in range(right if forth else width - left):
                column = k if forth else width - 1 - k
                at = row * width + column
                jump = _jump(guide, at, at if k == 0 else at - 1 if forth else at + 1, small, large, edge)
                wanted = left <= column < right
                goal = (row * (right - left) + column - left) * count if wanted else 0
                if wanted:
                    lowest = _step(one, two, lowest, scores, at * count, count, small, jump, total, goal, not forth)
                else:
                    # Columns outside this block aren't stored; their costs are needed only as input of the next pixels
                    # on the path.
                    lowest = _step(one, two, lowest, scores, at * count, count, small, jump, two, LANES, False)
                one, two = two, one


@internal(error_model="numpy")
def _choose(total, at, count):
    """(fractional plane of least cost, the whole plane, how much more the best plane at a distance from it costs)."""
    least = splat8(_INFINITY)
    for k in range(0, count, LANES):
        least = min8(load8(total, at + k), least)
    lowest = -largest8(-least)
    winner = 0
    for k in range(0, count, LANES):
        bits = bits8(load8(total, at + k) == lowest)
        if bits != 0:
            winner = k
            while bits & 1 == 0:
                bits >>= 1
                winner += 1
            break
    second = splat8(_INFINITY)
    for k in range(0, count, LANES):
        other = abs8(lanes8() + _F(k - winner)) > _F(FAR)
        second = min8(select8(other, load8(total, at + k), _INFINITY), second)
    return winner, lowest, -largest8(-second)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def down_columns(scores, guide, shape, known, small, large, edge, left, right, total, plane, score, margin):
    """Add both vertical paths to total (H, right - left, D), and choose. known: number of real planes among D; the
    others are padding."""
    height, width, count = shape
    wide = right - left
    for block in prange(-(-wide // COLUMNS)):
        start = left + block * COLUMNS
        columns = min(COLUMNS, right - start)
        one = np.empty((columns, count + 2 * LANES), np.float32)
        two = np.empty_like(one)
        lowest = np.empty(columns, np.float32)
        for down in (True, False):
            lowest[:] = _ZERO
            for column in range(columns):
                _begin(one[column], two[column], count)
            for k in range(height):
                row = k if down else height - 1 - k
                for column in range(columns):
                    at = row * width + start + column
                    jump = _jump(guide, at, at if k == 0 else at - width if down else at + width, small, large, edge)
                    goal = (row * wide + start - left + column) * count
                    lowest[column] = _step(
                        one[column], two[column], lowest[column], scores, at * count, count, small, jump, total, goal,
                        True,
                    )  # fmt: skip
                    if not down:
                        winner, cost, second = _choose(total, goal, count)
                        shift = _ZERO
                        if 0 < winner < known - 1:
                            before, after = total[goal + winner - 1], total[goal + winner + 1]
                            curvature = before - _F(2) * cost + after
                            if curvature > _ZERO:
                                shift = min(max(_HALF * (before - after) / curvature, -_HALF), _HALF)
                        plane[at] = _F(winner) + shift
                        score[at] = scores[at * count + winner]
                        margin[at] = (second - cost) / _F(4)
                one, two = two, one
