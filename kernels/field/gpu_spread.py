"""Triton kernel that takes gradients from a ray's samples to the channels of planes and lines: a program for a mode and
a group of channels of each ray, so that sums along a ray need no other program.

What a sample adds to nodes is only written down here, to be added up node by node (gpu_nodes.py).
"""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_rays import begin_and_end
from .gpu_stencil import columns_of, line_of, rows_around, rows_of


@triton.jit(do_not_specialize=["size", "part"])
def spread(
    flat, lights, gradient, origins, directions, places, starts, counts, lit, weights, colours, by_feature,
    by_planes, by_lines, by_lights, by_rays, size, nx, ny, nz, part,
    COLOUR: tl.constexpr, WANTED: tl.constexpr, RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """by_planes, by_lines: (S, 3, RANK), the gradients with respect to a sample's interpolated planes and lines.

    Of the density without COLOUR, by_feature being the gradient with respect to each of its channels; with COLOUR of
    the colour, by_lights (R, 3, 3 RANK) too. by_rays: (parts, R, 6), with WANTED, by origin and direction; this
    launch's parts begin at `part`."""
    ray = tl.program_id(0)
    mode = tl.program_id(1) // (RANK // CHANNELS)
    channel = (tl.program_id(1) % (RANK // CHANNELS) * CHANNELS + tl.arange(0, CHANNELS))[None, :]
    begin, _ = begin_and_end(starts, ray, size)
    many = tl.load(counts + 2 * ray + COLOUR)
    # The plane's axes and the line's.
    p, q, r = columns_of(mode, 0, 1, 2), rows_of(mode, 0, 1, 2), line_of(mode, 0, 1, 2)
    origin, direction = origins + 3 * ray, directions + 3 * ray
    of_ray = ray.to(tl.int64) * (9 * RANK) + mode * RANK + channel
    by_red = tl.zeros((BLOCK, CHANNELS), tl.float32)
    by_green = tl.zeros((BLOCK, CHANNELS), tl.float32)
    by_blue = tl.zeros((BLOCK, CHANNELS), tl.float32)
    by_place_p, by_place_q = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    by_place_r, by_turn_p = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    by_turn_q, by_turn_r = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    for first in range(0, many, BLOCK):
        k = first + tl.arange(0, BLOCK)
        inside = k < many
        s = begin + k
        if COLOUR:
            s = tl.load(lit + s, mask=inside, other=0)
        t = tl.load(places + s, mask=inside, other=0.0)
        across = tl.load(origin + p) + t * tl.load(direction + p)
        down = tl.load(origin + q) + t * tl.load(direction + q)
        along = tl.load(origin + r) + t * tl.load(direction + r)
        a, b, c, d, e, f, u, v, w = rows_around(flat, across, down, along, mode, nx, ny, nz, channel, inside, RANK)
        upper, lower = a + (b - a) * u, c + (d - c) * u
        plane, line = upper + (lower - upper) * v, e + (f - e) * w
        if COLOUR:
            weight = tl.load(weights + s, mask=inside, other=0.0)
            red = tl.load(colours + 3 * s, mask=inside, other=0.0)
            green = tl.load(colours + 3 * s + 1, mask=inside, other=0.0)
            blue = tl.load(colours + 3 * s + 2, mask=inside, other=0.0)
            red = (tl.load(gradient + 5 * ray) * weight * red * (1.0 - red))[:, None]
            green = (tl.load(gradient + 5 * ray + 1) * weight * green * (1.0 - green))[:, None]
            blue = (tl.load(gradient + 5 * ray + 2) * weight * blue * (1.0 - blue))[:, None]
            by_channels = red * tl.load(lights + of_ray) + green * tl.load(lights + of_ray + 3 * RANK)
            by_channels += blue * tl.load(lights + of_ray + 6 * RANK)
            value = plane * line
            by_red += red * value
            by_green += green * value
            by_blue += blue * value
        else:
            by_channels = tl.load(by_feature + s, mask=inside, other=0.0)[:, None] + tl.zeros_like(plane)
        by_plane, by_line = by_channels * line, by_channels * plane
        to = (s.to(tl.int64) * 3 + mode)[:, None] * RANK + channel
        tl.store(by_planes + to, by_plane, mask=inside[:, None])
        tl.store(by_lines + to, by_line, mask=inside[:, None])
        if WANTED:
            # A point outside the cube counts as on its border, and stays there if it moves.
            by_p = tl.sum(by_plane * ((b - a) + ((d - c) - (b - a)) * v), 1)
            by_p = tl.where((across >= 0.0) & (across <= 1.0), by_p, 0.0)
            by_q = tl.where((down >= 0.0) & (down <= 1.0), tl.sum(by_plane * (lower - upper), 1), 0.0)
            by_r = tl.where((along >= 0.0) & (along <= 1.0), tl.sum(by_line * (f - e), 1), 0.0)
            by_place_p, by_place_q, by_place_r = by_place_p + by_p, by_place_q + by_q, by_place_r + by_r
            by_turn_p, by_turn_q, by_turn_r = by_turn_p + t * by_p, by_turn_q + t * by_q, by_turn_r + t * by_r
    if COLOUR:
        tl.store(by_lights + of_ray, tl.sum(by_red, 0)[None, :])
        tl.store(by_lights + of_ray + 3 * RANK, tl.sum(by_green, 0)[None, :])
        tl.store(by_lights + of_ray + 6 * RANK, tl.sum(by_blue, 0)[None, :])
    if WANTED:
        to = by_rays + ((part + tl.program_id(1)) * tl.num_programs(0) + ray) * 6
        # From cells to the cube.
        columns, rows = columns_of(mode, nx, ny, nz) - 1, rows_of(mode, nx, ny, nz) - 1
        nodes = line_of(mode, nx, ny, nz) - 1
        tl.store(to + p, tl.sum(by_place_p, 0) * columns)
        tl.store(to + q, tl.sum(by_place_q, 0) * rows)
        tl.store(to + r, tl.sum(by_place_r, 0) * nodes)
        tl.store(to + 3 + p, tl.sum(by_turn_p, 0) * columns)
        tl.store(to + 3 + q, tl.sum(by_turn_q, 0) * rows)
        tl.store(to + 3 + r, tl.sum(by_turn_r, 0) * nodes)
