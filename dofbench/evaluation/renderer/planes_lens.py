"""Textured planes seen from aperture samples, compiled: row by row, nearest plane first."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal

ALL, LOWER_HALF, DISCS, BARS = range(4)
# Discs: centre as shares of width and height, radius in pixels. Bars: position as share of the width, half width in
# pixels, cosine and sine of the slant.
_DISCS = np.array([(0.28, 0.35, 42.0), (0.72, 0.55, 60.0), (0.45, 0.85, 30.0)])
_BARS = np.array(
    [
        (c, w, math.cos(t), math.sin(t))
        for c, w, t in ((0.2, 1.0, 0.1), (0.4, 2.0, -0.2), (0.6, 4.0, 0.3), (0.8, 1.5, -0.4))
    ]
)


@internal(fastmath=True, error_model="numpy")
def _cover(stencil, px, py, width, height, cover):
    """Write a stencil's coverage of each position (px, py), 0 ... 1 over one pixel around its edge, to `cover`."""
    n = len(px)
    if stencil == ALL:
        cover[:] = 1.0
        return
    cover[:] = -1e9  # signed distance to the edge, pixels, positive inside
    if stencil == LOWER_HALF:
        for c in range(n):
            cover[c] = py[c] - 0.45 * height
    elif stencil == DISCS:
        for i in range(len(_DISCS)):
            x, y, radius = _DISCS[i, 0] * width, _DISCS[i, 1] * height, _DISCS[i, 2]
            for c in range(n):
                cover[c] = max(cover[c], radius - math.sqrt((px[c] - x) ** 2 + (py[c] - y) ** 2))
    else:
        for i in range(len(_BARS)):
            x, half, cos, sin = _BARS[i, 0] * width, _BARS[i, 1], _BARS[i, 2], _BARS[i, 3]
            for c in range(n):
                cover[c] = max(cover[c], half - abs((px[c] - x) * cos + (py[c] - 0.5 * height) * sin))
    for c in range(n):
        cover[c] = min(max(cover[c] + 0.5, 0.0), 1.0)


@internal(fastmath=True, error_model="numpy")
def _add_shifted(picture, period, px0, py0, share, light, row):
    """Add share[c] times the bilinear picture at (px0 + c, py0) to light[:, row, c]."""
    left, top = math.floor(px0), math.floor(py0)
    right, lower = np.float32(px0 - left), np.float32(py0 - top)
    x, upper_row, lower_row = int(left) % period, int(top) % period, (int(top) + 1) % period
    one = np.float32(1.0)
    for channel in range(3):
        upper, below, into = picture[channel, upper_row], picture[channel, lower_row], light[channel, row]
        for c in range(len(share)):
            above = upper[x + c] * (one - right) + upper[x + c + 1] * right
            beneath = below[x + c] * (one - right) + below[x + c + 1] * right
            into[c] += share[c] * (above * (one - lower) + beneath * lower)


@internal(fastmath=True, error_model="numpy")
def _add_sampled(picture, period, px, py, share, light, row):
    """Add share[c] times the bilinear picture at (px[c], py[c]) to light[:, row, c]."""
    for c in range(len(share)):
        if share[c] <= 0.0:
            continue
        left, top = math.floor(px[c]), math.floor(py[c])
        right, lower = px[c] - left, py[c] - top
        x, y0, y1 = int(left) % period, int(top) % period, (int(top) + 1) % period
        for channel in range(3):
            rows = picture[channel]
            above = rows[y0, x] * (1.0 - right) + rows[y0, x + 1] * right
            beneath = rows[y1, x] * (1.0 - right) + rows[y1, x + 1] * right
            light[channel, row, c] += share[c] * (above * (1.0 - lower) + beneath * lower)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def add_views(pictures, period, stencils, radii, points, light, front):
    """Add each pixel's light from each aperture sample to `light`, (2, 3, H, W): even samples to the first half.

    pictures: (P, 3, period, period + W + 1) float32, far to near. stencils: (P,) integers. radii: (P, 3), the signed
    radius (a, bx, by) of a plane at p: a + bx px + by py pixels. points: (N, 2). front: (H, W), set to the signed
    radius of the nearest plane at each pixel for the last sample.
    """
    planes = len(stencils)
    height, width = front.shape
    for row in prange(height):
        px, py, s = np.empty(width), np.empty(width), np.empty(width)
        cover, share, through = np.empty(width), np.empty(width), np.empty(width)
        for i in range(len(points)):
            ux, uy = points[i, 0], points[i, 1]
            through[:] = 1.0
            for nearer in range(planes):
                plane = planes - 1 - nearer
                a, bx, by = radii[plane, 0], radii[plane, 1], radii[plane, 2]
                # x = p + s(p) u with s affine in p, so s = (a + b . x) / (1 + b . u).
                scale = 1.0 / (1.0 + bx * ux + by * uy)
                for c in range(width):
                    s[c] = (a + bx * c + by * row) * scale
                    px[c], py[c] = c - s[c] * ux, row - s[c] * uy
                _cover(stencils[plane], px, py, width, height, cover)
                if i == len(points) - 1:
                    for c in range(width):
                        if cover[c] > 0.5 and through[c] >= 0.5:
                            front[row, c] = s[c]
                lit = 0.0
                for c in range(width):
                    share[c] = through[c] * cover[c]
                    through[c] -= share[c]
                    lit = max(lit, share[c])
                if lit <= 0.0:
                    continue
                if bx == 0.0 and by == 0.0:
                    _add_shifted(pictures[plane], period, px[0], py[0], share, light[i % 2], row)
                else:
                    _add_sampled(pictures[plane], period, px, py, share, light[i % 2], row)
