"""Where rays meet occupied cells."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import cached
from dofbench.runtime.simd_functions import floor_int

from .cpu_stencil import ONE, ZERO

_RAYS_PER_TASK = 64


@njit(forceinline=True)
def _cell(coordinate, cells):
    return min(floor_int(min(max(coordinate, ZERO), ONE) * np.float32(cells)), cells - 1)


@njit(forceinline=True)
def _is_occupied(occupied, origins, directions, ray, place):
    depth, height, width = occupied.shape
    x = _cell(origins[ray, 0] + place * directions[ray, 0], width)
    y = _cell(origins[ray, 1] + place * directions[ray, 1], height)
    z = _cell(origins[ray, 2] + place * directions[ray, 2], depth)
    return occupied[z, y, x]


@cached
@njit(parallel=True, error_model="numpy")
def march(origins, directions, spans, offsets, occupied, count, starts, places, steps, fill):
    """First with fill False: starts[r + 1] becomes the number of ray r's samples. Then, with starts added up, with fill
    True: places and steps are filled."""
    rays = len(origins)
    for task in prange(-(-rays // _RAYS_PER_TASK)):
        for ray in range(task * _RAYS_PER_TASK, min(rays, (task + 1) * _RAYS_PER_TASK)):
            begin = spans[ray, 0]
            step = (spans[ray, 1] - begin) / np.float32(count)
            found = 0
            if step > ZERO:
                for k in range(count):
                    place = begin + (np.float32(k) + offsets[ray]) * step
                    if _is_occupied(occupied, origins, directions, ray, place):
                        if fill:
                            places[starts[ray] + found], steps[starts[ray] + found] = place, step
                        found += 1
            if not fill:
                starts[ray + 1] = found
