"""Rendering from several aperture samples: shifted records, and gradients by the shift."""

from __future__ import annotations

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
