"""Gradients of samples, spread over the nodes of planes and lines without atomics: each task owns rows of one plane."""

from __future__ import annotations

from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES
from dofbench.runtime.simd_memory import load1, load8, store8

from .cpu_stencil import ONE, ZERO, cell, line8, plane8

BANDS = 4  # of rows of a plane, each a task of its own; a fixed number, so that sums don't depend on the threads


@internal(forceinline=True)
def axes_of(mode):
    """(column, row, line) axis of a mode, as in `MODES`."""
    if mode == 0:
        return 0, 1, 2
    if mode == 1:
        return 0, 2, 1
    return 1, 2, 0


@cached
@njit(parallel=PRANGE, error_model="numpy")
def spread(flat, points, by_channels, step, nodes, offsets, rank, result, lines):
    """Fill result (like flat) with the gradient of `flat`.

    points: (P, 3). by_channels: flat; of point p those of mode m begin at step * (3 p + m), with as many numbers as a
    mode has channels if step is the rank, or with the one number that all channels share if step is 0: number p. lines:
    (BANDS, numbers of all lines), scratch.
    """
    first_line = offsets[3]
    for task in prange(3 * BANDS):
        mode, band = task // BANDS, task % BANDS
        column_axis, row_axis, line_axis = axes_of(mode)
        columns, rows, nodes_along = nodes[column_axis], nodes[row_axis], nodes[line_axis]
        low, high = band * rows // BANDS, (band + 1) * rows // BANDS
        plane_at, line_at = offsets[mode], offsets[3 + mode]
        row_step = columns * rank
        result[plane_at + low * row_step : plane_at + high * row_step] = ZERO
        mine = lines[band]
        own_line = line_at - first_line
        mine[own_line : own_line + nodes_along * rank] = ZERO
        for p in range(len(points)):
            j, v = cell(points[p, row_axis], rows)
            upper, lower = low <= j < high, low <= j + 1 < high
            if not (upper or lower):
                continue
            i, u = cell(points[p, column_axis], columns)
            k, w = cell(points[p, line_axis], nodes_along)
            at, along = plane_at + (j * columns + i) * rank, line_at + k * rank
            for channel in range(0, rank, LANES):
                line = line8(flat, along + channel, rank, w)
                if step == 0:
                    by_plane = line * load1(by_channels, p)
                else:
                    by_plane = line * load8(by_channels, step * (3 * p + mode) + channel)
                if upper:
                    add_pair(result, at + channel, rank, by_plane * (ONE - v), u)
                    plane = plane8(flat, at + channel, row_step, rank, u, v)
                    if step == 0:
                        by_line = plane * load1(by_channels, p)
                    else:
                        by_line = plane * load8(by_channels, step * (3 * p + mode) + channel)
                    add_pair(mine, own_line + k * rank + channel, rank, by_line, w)
                if lower:
                    add_pair(result, at + row_step + channel, rank, by_plane * v, u)
    for number in range(lines.shape[1]):
        total = ZERO
        for band in range(BANDS):
            total += lines[band, number]
        result[first_line + number] = total


@internal(forceinline=True)
def add_pair(result, at, rank, value, share):
    """Add a value to two neighbouring nodes, by the share of the way to the second."""
    second = value * share
    store8(result, at, load8(result, at) + (value - second))
    store8(result, at + rank, load8(result, at + rank) + second)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def points_of(numbers, ray_of, origins, directions, places, points):
    """Fill points (P, 3) with where the samples of these numbers lie."""
    for p in prange(len(numbers)):
        s = numbers[p]
        ray, t = ray_of[s], places[s]
        for axis in range(3):
            points[p, axis] = origins[ray, axis] + t * directions[ray, axis]
