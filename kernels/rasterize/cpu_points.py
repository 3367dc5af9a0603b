"""Rendering from several aperture samples: shifted records, and joined lists."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached
from dofbench.runtime.simd import LANES
from dofbench.runtime.simd_memory import load8, store8

from . import cpu_layout as layout
from .cpu_bin import count_tiles
from .cpu_layout import CHUNKS

WIDTH = 16  # floats of an intersection's gradient: no normals


@cached
@njit(parallel=PRANGE, error_model="numpy")
def shift_records(records, visible, radius, x, y, n, view, shifted, counts):
    """The records as seen from the lens point (x, y), and the number of tiles that each Gaussian meets from there."""
    for chunk in prange(CHUNKS):
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            counts[i] = 0
            if visible[i]:
                base = i * layout.RECORD
                store8(shifted, base, load8(records, base))
                store8(shifted, base + LANES, load8(records, base + LANES))
                shifted[base + layout.MX] += radius[i] * x
                shifted[base + layout.MY] += radius[i] * y
                counts[i] = count_tiles(shifted, i, view)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def times_point(gradients, x, y):
    """Write the products of every intersection's moments with the lens point (x, y) to its S_POINT_* places."""
    intersections = gradients.size // WIDTH
    for chunk in prange(CHUNKS):
        for k in range(chunk * intersections // CHUNKS, (chunk + 1) * intersections // CHUNKS):
            base = k * WIDTH
            by_x, by_y = gradients[base + layout.QX], gradients[base + layout.QY]
            gradients[base + layout.S_POINT_XX] = x * by_x
            gradients[base + layout.S_POINT_XY] = x * by_y + y * by_x
            gradients[base + layout.S_POINT_YY] = y * by_y


@cached
@njit(parallel=PRANGE, error_model="numpy")
def join_places(offsets, places, first):
    """One list of places a Gaussian, over all lens points, in the order of the points.

    offsets: (P, N + 1), those of each point; places: (total,), all points' one after the other; first: (P + 1,), where
    each point's begin. Returns joined offsets (N + 1,) and places (total,).
    """
    points, n = offsets.shape[0], offsets.shape[1] - 1
    joined, order = np.empty(n + 1, np.int32), np.empty_like(places)
    for chunk in prange(CHUNKS):
        for i in range(chunk * (n + 1) // CHUNKS, (chunk + 1) * (n + 1) // CHUNKS):
            before = 0
            for p in range(points):
                before += offsets[p, i]
            joined[i] = before
            if i < n:
                for p in range(points):
                    for k in range(offsets[p, i], offsets[p, i + 1]):
                        order[before] = places[first[p] + k]
                        before += 1
    return joined, order
