"""Triton kernels that add up what samples add to the nodes of planes and lines, always in the same order.

A sample lies in one cell of each of three planes and three lines. A list holds every sample six times, sorted by these
cells, and a node adds up the samples of the cells around it. A cell has two numbers: 2 c for its samples with a colour,
2 c + 1 for those without, which come after them. So the colour's nodes read the first part of a cell's samples, and the
density's nodes read all of them.
"""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_stencil import cell, columns_of, first_of_line, first_of_plane, line_of, pick, places_of, rows_of


@triton.jit
def first_plane_cell(mode, nx, ny, nz):
    """The number of the first cell of a mode's plane."""
    return pick(mode, 0, (nx - 1) * (ny - 1), (nx - 1) * (ny + nz - 2))


@triton.jit
def first_line_cell(mode, nx, ny, nz):
    """The number of the first cell of a mode's line."""
    return (nx - 1) * (ny + nz - 2) + (ny - 1) * (nz - 1) + pick(mode, 0, nz - 1, nz + ny - 2)


@triton.jit(do_not_specialize=["size", "nowhere"])
def find_cells(
    origins, directions, ray_of, places, weights, cells, shares, size, nx, ny, nz, least_weight, nowhere,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """cells: (6, S), the numbers of each sample's cells, `nowhere` if it has no weight. shares: (S, 3), of the way to
    the next node along x, y and z."""
    s = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = s < size
    t = tl.load(places + s, mask=inside, other=0.0)
    x, y, z = places_of(origins, directions, tl.load(ray_of + s, mask=inside, other=0), t, inside)
    i, u = cell(x, nx)
    j, v = cell(y, ny)
    k, w = cell(z, nz)
    tl.store(shares + 3 * s, u, mask=inside)
    tl.store(shares + 3 * s + 1, v, mask=inside)
    tl.store(shares + 3 * s + 2, w, mask=inside)
    weight = tl.load(weights + s, mask=inside, other=0.0)
    without_colour = tl.where(weight >= least_weight, 0, 1)
    for mode in tl.static_range(3):
        place = rows_of(mode, j, j, k)
        place = pick(mode, j, k, k) * (columns_of(mode, nx, ny, nz) - 1) + pick(mode, i, i, j)
        number = 2 * (first_plane_cell(mode, nx, ny, nz) + place) + without_colour
        tl.store(cells + mode * size + s, tl.where(weight != 0.0, number, nowhere), mask=inside)
        number = 2 * (first_line_cell(mode, nx, ny, nz) + pick(mode, k, j, i)) + without_colour
        tl.store(cells + (3 + mode) * size + s, tl.where(weight != 0.0, number, nowhere), mask=inside)


@triton.jit(do_not_specialize=["size"])
def add_to_planes(
    by_planes, order, first_in, shares, result, size, nx, ny, nz,
    NUMBERS: tl.constexpr, RANK: tl.constexpr, CHANNELS: tl.constexpr, NODES: tl.constexpr, EACH: tl.constexpr,
):  # fmt: skip
    """The gradient of the planes' nodes: a block of nodes and of channels in each program.

    by_planes: (S, 3, RANK). order: (6 S,), where the sorted cells were before. first_in: where in it each number of a
    cell begins. NUMBERS: how many of a cell's two numbers count. EACH: samples of each cell around a node that are read
    at once.
    """
    n = (tl.program_id(0) * NODES + tl.arange(0, NODES))[:, None]
    inside = n < first_of_line(0, nx, ny, nz)
    mode = (n >= nx * ny).to(tl.int32) + (n >= nx * (ny + nz)).to(tl.int32)
    columns, rows = columns_of(mode, nx, ny, nz), rows_of(mode, nx, ny, nz)
    place = n - first_of_plane(mode, nx, ny, nz)
    # Four cells meet in a node. It is the right node of those to its left, and the lower one of those above it.
    item = tl.arange(0, 4 * EACH)[None, :]
    is_right, is_lower = item % 2, item // 2 % 2
    i, j = place % columns - is_right, place // columns - is_lower
    there = inside & (i >= 0) & (i < columns - 1) & (j >= 0) & (j < rows - 1)
    number = 2 * (first_plane_cell(mode, nx, ny, nz) + j * (columns - 1) + i)
    begin = tl.load(first_in + number, mask=there, other=0)
    many = tl.load(first_in + number + NUMBERS, mask=there, other=0) - begin
    channel = tl.program_id(1) * CHANNELS + tl.arange(0, CHANNELS)
    total = tl.zeros((NODES, 4 * EACH, CHANNELS), tl.float32)
    for first in range(0, tl.max(tl.max(many, 1), 0), EACH):
        k = first + item // 4
        some = k < many
        s = tl.load(order + begin + k, mask=some, other=0) - mode * size
        u = tl.load(shares + 3 * s + columns_of(mode, 0, 1, 2), mask=some, other=0.0)
        v = tl.load(shares + 3 * s + rows_of(mode, 0, 1, 2), mask=some, other=0.0)
        # u or 1 - u, and v or 1 - v, by arithmetic: from a choice the compiler makes a copy of the loop for each of the
        # four cells, and a warp, whose threads have all of them, goes through all copies.
        share = (1 - is_right + (2 * is_right - 1) * u) * (1 - is_lower + (2 * is_lower - 1) * v)
        come = by_planes + (3 * s + mode)[:, :, None] * RANK + channel[None, None, :]
        total += share[:, :, None] * tl.load(come, mask=some[:, :, None], other=0.0)
    tl.store(result + n * RANK + channel[None, :], tl.sum(total, 1), mask=inside)


@triton.jit(do_not_specialize=["size"])
def add_in_line_cells(
    by_lines, order, first_in, shares, sums, size, nx, ny, nz,
    NUMBERS: tl.constexpr, RANK: tl.constexpr, CHANNELS: tl.constexpr, EACH: tl.constexpr,
):  # fmt: skip
    """sums: (cells of the lines, parts, 2, RANK), what the samples of a part of each cell's list add to its two nodes.

    A line has few cells, each with many samples, so several programs share a cell.
    """
    number = tl.program_id(0)
    mode = (number >= nz - 1).to(tl.int32) + (number >= nz + ny - 2).to(tl.int32)
    of_cell = first_in + 2 * (first_line_cell(0, nx, ny, nz) + number)
    begin = tl.load(of_cell)
    end = tl.load(of_cell + NUMBERS)
    part, parts = tl.program_id(1), tl.num_programs(1)
    each = tl.cdiv(end - begin, parts)
    begin += part * each
    end = tl.minimum(begin + each, end)
    channel = (tl.program_id(2) * CHANNELS + tl.arange(0, CHANNELS))[None, :]
    to_first = tl.zeros((EACH, CHANNELS), tl.float32)
    to_second = tl.zeros((EACH, CHANNELS), tl.float32)
    for first in range(begin, end, EACH):
        k = first + tl.arange(0, EACH)
        some = k < end
        s = tl.load(order + k, mask=some, other=0) - (3 + mode) * size
        w = tl.load(shares + 3 * s + line_of(mode, 0, 1, 2), mask=some, other=0.0)[:, None]
        come = by_lines + (3 * s + mode)[:, None] * RANK + channel
        value = tl.load(come, mask=some[:, None], other=0.0)
        to_first += (1.0 - w) * value
        to_second += w * value
    to = sums + (number * parts + part) * (2 * RANK) + channel
    tl.store(to, tl.sum(to_first, 0)[None, :])
    tl.store(to + RANK, tl.sum(to_second, 0)[None, :])


@triton.jit
def add_to_lines(
    sums, result, nx, ny, nz, RANK: tl.constexpr, CHANNELS: tl.constexpr, PARTS: tl.constexpr, NODES: tl.constexpr
):  # fmt: skip
    """The gradient of the lines' nodes, each from the cells before and behind it."""
    n = tl.program_id(0) * NODES + tl.arange(0, NODES)
    mode = (n >= nz).to(tl.int32) + (n >= nz + ny).to(tl.int32)
    inside = n < nx + ny + nz
    place = n - pick(mode, 0, nz, nz + ny)
    # A line has one cell less than nodes, so its first cell's number is as much less as there are lines before it.
    number = n - mode
    channel = tl.program_id(1) * CHANNELS + tl.arange(0, CHANNELS)
    part = tl.arange(0, PARTS)[None, :, None]
    before = sums + ((number - 1)[:, None, None] * PARTS + part) * (2 * RANK) + RANK + channel[None, None, :]
    total = tl.sum(tl.load(before, mask=(inside & (place > 0))[:, None, None], other=0.0), 1)
    behind = sums + (number[:, None, None] * PARTS + part) * (2 * RANK) + channel[None, None, :]
    last = place == line_of(mode, nx, ny, nz) - 1
    total += tl.sum(tl.load(behind, mask=(inside & ~last)[:, None, None], other=0.0), 1)
    to = result + (first_of_line(0, nx, ny, nz) + n)[:, None] * RANK + channel[None, :]
    tl.store(to, total, mask=inside[:, None])
