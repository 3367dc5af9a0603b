"""Plane-sweep stereo for the CPU: `stereo`, `upsample`, `semiglobal`, float32; see `reference.py`.

Bands of rows (columns, for the vertical paths) run in parallel and write to places of their own, so the number of
threads changes no bit. No fastmath, for the reason that `ssim/_kernels.py` gives.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from dofbench.kernel_cache import cached

from .reference import CENTRE, FAR, FLOOR, UNKNOWN, check

BAND = 16     # rows of a task of the sweep
COLUMNS = 32  # columns of a task of the vertical paths
_u = np.uint64
_F = np.float32
_ZERO, _ONE, _HALF, _INFINITY = _F(0), _F(1), _F(0.5), _F(np.inf)


@njit(error_model="numpy")
def _warp(image, matrix, disparity, first, radius, warped, inside, at, along, down):
    """Fill warped (h, w) with the source seen at the plane; row 0 and column 0 are pixel (first, -radius).

    inside (h, w): 1 where that is in the source, else 0. at, along, down: (w,) scratch. Coordinates are
    found a row at a time, which vectorises, apart from the reads at them, which don't.
    """
    height, width = image.shape
    last_x, last_y = _F(width - 1), _F(height - 1)
    most_x, most_y = _F(max(width - 2, 0)), _F(max(height - 2, 0))
    wide, high = _F(width), _F(height)
    right, below = _u(min(1, width - 1)), _u(min(1, height - 1) * width)
    flat, pitch = image.reshape(-1), np.int32(width)
    a, b, c = matrix[0, 0], matrix[1, 0], matrix[2, 0]
    for row in range(warped.shape[0]):
        y = _F(first + row) + _HALF
        u0 = matrix[0, 1] * y + (matrix[0, 2] + matrix[0, 3] * disparity)
        v0 = matrix[1, 1] * y + (matrix[1, 2] + matrix[1, 3] * disparity)
        w0 = matrix[2, 1] * y + (matrix[2, 2] + matrix[2, 3] * disparity)
        for column in range(warped.shape[1]):
            x = _F(np.int32(column - radius)) + _HALF
            w = c * x + w0
            u = (a * x + u0) / w
            v = (b * x + v0) / w
            there = (w > _ZERO) & (u >= _ZERO) & (u < wide) & (v >= _ZERO) & (v < high)
            inside[row, column] = _ONE if there else _ZERO
            u -= _HALF
            v -= _HALF
            u = u if u > _ZERO else _ZERO  # NaN too
            v = v if v > _ZERO else _ZERO
            u = u if u < last_x else last_x
            v = v if v < last_y else last_y
            left = np.int32(u if u < most_x else most_x)
            top = np.int32(v if v < most_y else most_y)
            along[column] = u - _F(left)
            down[column] = v - _F(top)
            at[column] = top * pitch + left
        for column in range(warped.shape[1]):
            place, x, y = _u(at[column]), along[column], down[column]
            upper = flat[place] + x * (flat[place + right] - flat[place])
            lower = flat[place + below] + x * (flat[place + below + right] - flat[place + below])
            warped[row, column] = upper + y * (lower - upper)


@njit(error_model="numpy")
def _box(product, radius, column_sums, out):
    """out (h, w): mean of product (h + 2 radius, w + 2 radius) over the window."""
    side = 2 * radius + 1
    share = _ONE / _F(side * side)
    for row in range(out.shape[0]):
        for column in range(column_sums.shape[0]):
            column_sums[column] = product[row, column]
        for k in range(1, side):
            for column in range(column_sums.shape[0]):
                column_sums[column] += product[row + k, column]
        for column in range(out.shape[1]):
            out[row, column] = column_sums[column]
        for k in range(1, side):
            for column in range(out.shape[1]):
                out[row, column] += column_sums[column + k]
        for column in range(out.shape[1]):
            out[row, column] *= share


@njit(error_model="numpy")
def _multiply(a, b, out):
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            out[row, column] = a[row, column] * b[row, column]


@cached
@njit(parallel=True, error_model="numpy")
def _sweep(reference, sources, maps, disparities, radius, best, scores):
    height, width, count = scores.shape
    for band in prange(-(-height // BAND)):
        top = band * BAND
        rows = min(BAND, height - top)
        wide = width + 2 * radius
        patch = np.empty((rows + 2 * radius, wide), np.float32)
        for row in range(rows + 2 * radius):
            y = min(max(top + row - radius, 0), height - 1)
            for column in range(wide):
                patch[row, column] = reference[y, min(max(column - radius, 0), width - 1)]
        product = np.empty_like(patch)
        warped = np.empty_like(patch)
        inside = np.empty_like(patch)
        at, along, down = np.empty(wide, np.int32), np.empty(wide, np.float32), np.empty(wide, np.float32)
        sums = np.empty(wide, np.float32)
        own, own_variance = np.empty((rows, width), np.float32), np.empty((rows, width), np.float32)
        other, variance = np.empty((rows, width), np.float32), np.empty((rows, width), np.float32)
        mixed = np.empty((rows, width), np.float32)
        largest = np.empty((best, rows, width), np.float32)
        plane = np.empty((count, rows, width), np.float32)
        _box(patch, radius, sums, own)
        _multiply(patch, patch, product)
        _box(product, radius, sums, own_variance)
        for row in range(rows):
            for column in range(width):
                value = own_variance[row, column] - own[row, column] * own[row, column]
                own_variance[row, column] = (value if value > _ZERO else _ZERO) + _F(FLOOR)
        for index in range(count):
            largest[:] = -_INFINITY
            for s in range(sources.shape[0]):
                _warp(sources[s], maps[s], disparities[index], top - radius, radius, warped, inside, at, along, down)
                _box(warped, radius, sums, other)
                _multiply(warped, warped, product)
                _box(product, radius, sums, variance)
                _multiply(warped, patch, product)
                _box(product, radius, sums, mixed)
                for row in range(rows):
                    for column in range(width):
                        value = variance[row, column] - other[row, column] * other[row, column]
                        value = (value if value > _ZERO else _ZERO) + _F(FLOOR)
                        score = mixed[row, column] - own[row, column] * other[row, column]
                        score /= np.sqrt(own_variance[row, column] * value)
                        seen = inside[row + radius, column + radius] > _ZERO
                        mixed[row, column] = score if seen else -_INFINITY
                    for k in range(best):
                        for column in range(width):
                            score, kept = mixed[row, column], largest[k, row, column]
                            largest[k, row, column] = score if score > kept else kept
                            mixed[row, column] = kept if score > kept else score
            for row in range(rows):
                for column in range(width):
                    total, seen = _ZERO, 0
                    for k in range(best):
                        if largest[k, row, column] > -_INFINITY:
                            total += largest[k, row, column]
                            seen += 1
                    plane[index, row, column] = total / _F(seen) if seen > 0 else _F(UNKNOWN)
        for row in range(rows):
            for column in range(width):
                for index in range(count):
                    scores[top + row, column, index] = plane[index, row, column]


def stereo(reference: Tensor, sources: Tensor, maps: Tensor, disparities: Tensor, *, radius: int, best: int) -> Tensor:
    """Scores (H, W, D) of each pixel at each plane; see `reference.stereo`. float32 on the CPU.

    Raises ValueError for what it can't take.
    """
    check(reference, sources, maps, disparities, radius, best)
    scores = np.empty((*reference.shape, len(disparities)), np.float32)
    single = [tensor.detach().to(torch.float32).contiguous().numpy()
              for tensor in (reference, sources, maps, disparities)]
    single[0], single[1] = single[0] - _F(CENTRE), single[1] - _F(CENTRE)
    _sweep(*single, radius, best, scores)
    return torch.from_numpy(scores)


@cached
@njit(parallel=True, error_model="numpy")
def _add(scores, coarse, weight):
    height, width, count = scores.shape
    low, narrow = coarse.shape[0], coarse.shape[1]
    for row in prange(height):
        y = max((_F(row) + _HALF) * _F(low) / _F(height) - _HALF, _ZERO)
        top = min(np.int64(y), low - 1)
        bottom = min(top + 1, low - 1)
        y -= _F(top)
        for column in range(width):
            x = max((_F(column) + _HALF) * _F(narrow) / _F(width) - _HALF, _ZERO)
            left = min(np.int64(x), narrow - 1)
            right = min(left + 1, narrow - 1)
            x -= _F(left)
            a, b = weight * (_ONE - y) * (_ONE - x), weight * (_ONE - y) * x
            c, d = weight * y * (_ONE - x), weight * y * x
            for k in range(count):
                scores[row, column, k] += (a * coarse[top, left, k] + b * coarse[top, right, k]
                                           + c * coarse[bottom, left, k] + d * coarse[bottom, right, k])


def upsample(scores: Tensor, coarse: Tensor, weight: float) -> None:
    """Add a coarser level's scores, enlarged, to scores (H, W, D), in place; see `reference.upsample`."""
    _add(scores.numpy(), coarse.contiguous().numpy(), _F(weight))


@njit(error_model="numpy")
def _step(cost, own, small, jump, total):
    """One step along a path: cost (D + 2,), infinite at both ends, becomes that of the next pixel, added to total."""
    count = own.shape[0]
    lowest = cost[1]
    for k in range(1, count):
        lowest = cost[k + 1] if cost[k + 1] < lowest else lowest
    highest = lowest + jump
    before = cost[0]
    for k in range(count):
        here, after = cost[k + 1], cost[k + 2]
        way = before if before < after else after
        way += small
        way = way if way < here else here
        way = way if way < highest else highest
        before = here
        cost[k + 1] = way - lowest - own[k]
        total[k] += cost[k + 1]


@njit(error_model="numpy")
def _jump(one, other, small, large, edge):
    value = large / (_ONE + abs(one - other) / edge)
    return value if value > small else small


@njit(error_model="numpy")
def _begin(cost, own, total):
    cost[0] = cost[own.shape[0] + 1] = _INFINITY
    for k in range(own.shape[0]):
        cost[k + 1] = -own[k]
        total[k] += cost[k + 1]


@cached
@njit(parallel=True, error_model="numpy")
def _paths(scores, guide, small, large, edge, total):
    height, width, count = scores.shape
    for row in prange(height):
        cost = np.empty(count + 2, np.float32)
        for direction in (1, -1):
            first = 0 if direction == 1 else width - 1
            _begin(cost, scores[row, first], total[row, first])
            for k in range(1, width):
                at = first + direction * k
                jump = _jump(guide[row, at], guide[row, at - direction], small, large, edge)
                _step(cost, scores[row, at], small, jump, total[row, at])
    for block in prange(-(-width // COLUMNS)):
        left = block * COLUMNS
        right = min(left + COLUMNS, width)
        costs = np.empty((COLUMNS, count + 2), np.float32)
        for direction in (1, -1):
            first = 0 if direction == 1 else height - 1
            for column in range(left, right):
                _begin(costs[column - left], scores[first, column], total[first, column])
            for k in range(1, height):
                at = first + direction * k
                for column in range(left, right):
                    jump = _jump(guide[at, column], guide[at - direction, column], small, large, edge)
                    _step(costs[column - left], scores[at, column], small, jump, total[at, column])


@cached
@njit(parallel=True, error_model="numpy")
def _choose(scores, total, plane, score, margin):
    height, width, count = scores.shape
    for row in prange(height):
        for column in range(width):
            cost = total[row, column]
            winner = 0
            for k in range(1, count):
                if cost[k] < cost[winner]:
                    winner = k
            second = _INFINITY
            for k in range(count):
                if abs(k - winner) > FAR and cost[k] < second:
                    second = cost[k]
            shift = _ZERO
            if 0 < winner < count - 1:
                left, right = cost[winner - 1], cost[winner + 1]
                curvature = left - _F(2) * cost[winner] + right
                if curvature > _ZERO:
                    shift = min(max(_HALF * (left - right) / curvature, -_HALF), _HALF)
            plane[row, column] = _F(winner) + shift
            score[row, column] = scores[row, column, winner]
            margin[row, column] = (second - cost[winner]) / _F(4)


def semiglobal(scores: Tensor, guide: Tensor, *, small: float, large: float, edge: float
               ) -> tuple[Tensor, Tensor, Tensor]:
    """(plane, score, margin), each (H, W); see `reference.semiglobal`. float32 on the CPU."""
    volume, grey = scores.contiguous().numpy(), guide.detach().to(torch.float32).contiguous().numpy()
    total = np.zeros_like(volume)
    _paths(volume, grey, _F(small), _F(large), _F(edge), total)
    plane, score, margin = (np.empty(volume.shape[:2], np.float32) for _ in range(3))
    _choose(volume, total, plane, score, margin)
    return tuple(torch.from_numpy(values) for values in (plane, score, margin))
