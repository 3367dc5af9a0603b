"""Where a point lies between the nodes of a factorised grid, and the planes and lines interpolated there.

Channels are handled eight at a time. A point's stencil holds for each of three modes, in the order of `MODES`: the
index of its plane's first number, the step to the next row, the shares of the way to the next column and row, the index
of its line's first number, and the share of the way to the line's next node.
"""

from __future__ import annotations

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd_functions import floor_int
from dofbench.runtime.simd_memory import load8

ZERO = np.float32(0.0)
ONE = np.float32(1.0)


@internal(forceinline=True)
def cell(coordinate, nodes):
    """The node below a coordinate in [0, 1], and the share of the way to the next."""
    scaled = min(max(coordinate, ZERO), ONE) * np.float32(nodes - 1)
    below = min(floor_int(scaled), nodes - 2)
    return below, scaled - np.float32(below)


@internal(forceinline=True)
def stencil(x, y, z, nodes, offsets, rank):
    """The stencil of a point. nodes: along x, y, z. offsets: of three planes and three lines, as `GridShape` has
    them."""
    nx, ny, nz = nodes
    i, u = cell(x, nx)
    j, v = cell(y, ny)
    k, w = cell(z, nz)
    p0, p1, p2, l0, l1, l2 = offsets
    return (
        (p0 + (j * nx + i) * rank, nx * rank, u, v, l0 + k * rank, w),
        (p1 + (k * nx + i) * rank, nx * rank, u, w, l1 + j * rank, v),
        (p2 + (k * ny + j) * rank, ny * rank, v, w, l2 + i * rank, u),
    )


@internal(forceinline=True)
def plane8(flat, at, row, rank, u, v):
    """Eight channels of a plane."""
    upper, lower = load8(flat, at), load8(flat, at + row)
    upper = upper + (load8(flat, at + rank) - upper) * u
    lower = lower + (load8(flat, at + row + rank) - lower) * u
    return upper + (lower - upper) * v


@internal(forceinline=True)
def plane_slopes8(flat, at, row, rank, u, v):
    """Eight channels of a plane, and their derivatives with respect to u and v."""
    upper, lower = load8(flat, at), load8(flat, at + row)
    upper_step, lower_step = load8(flat, at + rank) - upper, load8(flat, at + row + rank) - lower
    upper, lower = upper + upper_step * u, lower + lower_step * u
    down = lower - upper
    return upper + down * v, upper_step + (lower_step - upper_step) * v, down


@internal(forceinline=True)
def line8(flat, at, rank, w):
    """Eight channels of a line."""
    first = load8(flat, at)
    return first + (load8(flat, at + rank) - first) * w


@internal(forceinline=True)
def line_slope8(flat, at, rank, w):
    """Eight channels of a line, and their derivatives with respect to w."""
    first = load8(flat, at)
    step = load8(flat, at + rank) - first
    return first + step * w, step


@internal(forceinline=True)
def product8(flat, mode, rank, channel):
    """Eight channels of a mode, from `channel` on: plane times line."""
    at, row, u, v, line_at, w = mode
    return plane8(flat, at + channel, row, rank, u, v) * line8(flat, line_at + channel, rank, w)


@internal(forceinline=True)
def product_slopes8(flat, mode, rank, channel):
    """The derivatives of a mode's eight channels by u, v and w."""
    at, row, u, v, line_at, w = mode
    plane, across, down = plane_slopes8(flat, at + channel, row, rank, u, v)
    line, along = line_slope8(flat, line_at + channel, rank, w)
    return across * line, down * line, plane * along
