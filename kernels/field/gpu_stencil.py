"""Reading a grid in the field's Triton kernels: where points lie between its nodes, and planes times lines there.

Blocks are (samples, channels). A grid is a matrix of one row of channels a node: the nodes of three planes, row by row,
then those of three lines, in the order of `MODES`. `mode`, 0 to 2, may be a constant, a number, or a block of numbers.
"""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def pick(mode, first, second, third):
    """One of three values by the mode."""
    return tl.where(mode == 0, first, tl.where(mode == 1, second, third))


@triton.jit
def columns_of(mode, x, y, z):
    """Of three values along x, y and z, that along the columns of a mode's plane."""
    return pick(mode, x, x, y)


@triton.jit
def rows_of(mode, x, y, z):
    """That along the rows of a mode's plane."""
    return pick(mode, y, z, z)


@triton.jit
def line_of(mode, x, y, z):
    """That along a mode's line."""
    return pick(mode, z, y, x)


@triton.jit
def first_of_plane(mode, nx, ny, nz):
    """The number of the first node of a mode's plane."""
    return pick(mode, 0, nx * ny, nx * (ny + nz))


@triton.jit
def first_of_line(mode, nx, ny, nz):
    """The number of the first node of a mode's line."""
    return nx * (ny + nz) + ny * nz + pick(mode, 0, nz, nz + ny)


@triton.jit
def cell(coordinate, nodes):
    """The node below each coordinate, and the share of the way to the next; outside [0, 1] as on the border.

    The share of a coordinate that isn't finite is NaN, and so is the result.
    """
    scaled = tl.minimum(tl.where(coordinate > 0.0, coordinate, 0.0), 1.0) * (nodes - 1)
    below = tl.minimum(scaled.to(tl.int32), nodes - 2)
    return below, tl.where(tl.abs(coordinate) < float("inf"), scaled - below, float("nan"))


@triton.jit
def three_of(rows, number, inside):
    """The three numbers of rows (N, 3): x, y and z of points or directions."""
    x = tl.load(rows + 3 * number, mask=inside, other=0.0)
    y = tl.load(rows + 3 * number + 1, mask=inside, other=0.0)
    return x, y, tl.load(rows + 3 * number + 2, mask=inside, other=0.0)


@triton.jit
def places_of(origins, directions, ray, t, inside):
    """x, y and z at places t along rays."""
    x = tl.load(origins + 3 * ray, mask=inside, other=0.0) + t * tl.load(directions + 3 * ray, mask=inside, other=0.0)
    y = tl.load(origins + 3 * ray + 1, mask=inside, other=0.0)
    y += t * tl.load(directions + 3 * ray + 1, mask=inside, other=0.0)
    z = tl.load(origins + 3 * ray + 2, mask=inside, other=0.0)
    z += t * tl.load(directions + 3 * ray + 2, mask=inside, other=0.0)
    return x, y, z


@triton.jit
def rows_around(flat, across, down, along, mode, nx, ny, nz, channel, inside, RANK: tl.constexpr):
    """Values of a mode's nodes around points: four rows of the plane, upper left, upper right, lower left, lower right;
    two of the line; and the shares of the way from column to column, from row to row and along the line.

    across, down, along: the points' coordinates along the plane's columns and rows and along the line. channel: (1,
    channels), the numbers of those that are read.
    """
    columns = columns_of(mode, nx, ny, nz)
    i, u = cell(across, columns)
    j, v = cell(down, rows_of(mode, nx, ny, nz))
    k, w = cell(along, line_of(mode, nx, ny, nz))
    some = inside[:, None]
    at = flat + (first_of_plane(mode, nx, ny, nz) + j * columns + i)[:, None] * RANK + channel
    a, b = tl.load(at, mask=some, other=0.0), tl.load(at + RANK, mask=some, other=0.0)
    at += columns * RANK
    c, d = tl.load(at, mask=some, other=0.0), tl.load(at + RANK, mask=some, other=0.0)
    at = flat + (first_of_line(mode, nx, ny, nz) + k)[:, None] * RANK + channel
    e, f = tl.load(at, mask=some, other=0.0), tl.load(at + RANK, mask=some, other=0.0)
    return a, b, c, d, e, f, u[:, None], v[:, None], w[:, None]


@triton.jit
def product(flat, x, y, z, mode, nx, ny, nz, channel, inside, RANK: tl.constexpr):
    """(samples, channels) of a mode: plane times line."""
    across, down, along = columns_of(mode, x, y, z), rows_of(mode, x, y, z), line_of(mode, x, y, z)
    a, b, c, d, e, f, u, v, w = rows_around(flat, across, down, along, mode, nx, ny, nz, channel, inside, RANK)
    upper, lower = a + (b - a) * u, c + (d - c) * u
    return (upper + (lower - upper) * v) * (e + (f - e) * w)


@triton.jit
def density_feature(
    flat, x, y, z, nx, ny, nz, inside, RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr
):  # fmt: skip
    """(BLOCK,) the sum of all channels of the density at points."""
    total = tl.zeros((BLOCK,), tl.float32)
    for mode in tl.static_range(3):
        for first in range(0, RANK, CHANNELS):
            channel = (first + tl.arange(0, CHANNELS))[None, :]
            total += tl.sum(product(flat, x, y, z, mode, nx, ny, nz, channel, inside, RANK), 1)
    return total
