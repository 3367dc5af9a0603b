"""Colour from spherical harmonics, eight Gaussians at a time; 3DGS' real basis and its signs.

Term k = 0 … 15 of the series lies at buffer[8 k : 8 k + 8].
"""

from __future__ import annotations

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd import LANES, splat8
from dofbench.runtime.simd_functions import sqrt8
from dofbench.runtime.simd_memory import load8, prefetch, store8
from dofbench.runtime.simd_rows import gather8_at, load_rows8_at, scatter8_at, store_rows8_at

TERMS = 16
_LINE = 16  # floats of a cache line
C0 = np.float32(0.28209479177387814)
C1 = np.float32(0.4886025119029199)
C2A, C2B, C2C = np.float32(1.0925484305920792), np.float32(0.31539156525252005), np.float32(0.5462742152960396)
C3A, C3B, C3C = np.float32(0.5900435899266435), np.float32(2.890611442640554), np.float32(0.4570457994644658)
C3D, C3E = np.float32(0.3731763325901154), np.float32(1.445305721320277)
ONE, TWO, THREE = np.float32(1.0), np.float32(2.0), np.float32(3.0)
FOUR, SIX, EIGHT = np.float32(4.0), np.float32(6.0), np.float32(8.0)
HALF = np.float32(0.5)
ZERO = np.float32(0.0)


@internal(error_model="numpy")
def fill_basis(buffer, degree, x, y, z):
    """The basis functions in unit direction (x, y, z), up to `degree`."""
    store8(buffer, 0 * LANES, splat8(C0))
    if degree > 0:
        store8(buffer, 1 * LANES, -C1 * y)
        store8(buffer, 2 * LANES, C1 * z)
        store8(buffer, 3 * LANES, -C1 * x)
    xx, yy, zz = x * x, y * y, z * z
    if degree > 1:
        store8(buffer, 4 * LANES, C2A * x * y)
        store8(buffer, 5 * LANES, -C2A * y * z)
        store8(buffer, 6 * LANES, C2B * (TWO * zz - xx - yy))
        store8(buffer, 7 * LANES, -C2A * x * z)
        store8(buffer, 8 * LANES, C2C * (xx - yy))
    if degree > 2:
        store8(buffer, 9 * LANES, -C3A * y * (THREE * xx - yy))
        store8(buffer, 10 * LANES, C3B * x * y * z)
        store8(buffer, 11 * LANES, -C3C * y * (FOUR * zz - xx - yy))
        store8(buffer, 12 * LANES, C3D * z * (TWO * zz - THREE * xx - THREE * yy))
        store8(buffer, 13 * LANES, -C3C * x * (FOUR * zz - xx - yy))
        store8(buffer, 14 * LANES, C3E * z * (xx - yy))
        store8(buffer, 15 * LANES, -C3A * x * (xx - THREE * yy))


@internal(error_model="numpy")
def direction_gradient(f, degree, x, y, z):
    """dL/d(unit direction) from dL/d(each basis function), which the buffer f holds."""
    gx, gy, gz = splat8(ZERO), splat8(ZERO), splat8(ZERO)
    if degree > 0:
        f1, f2, f3 = load8(f, 1 * LANES), load8(f, 2 * LANES), load8(f, 3 * LANES)
        gx, gy, gz = -C1 * f3, -C1 * f1, C1 * f2
    if degree > 1:
        f4, f5, f6 = load8(f, 4 * LANES), load8(f, 5 * LANES), load8(f, 6 * LANES)
        f7, f8 = load8(f, 7 * LANES), load8(f, 8 * LANES)
        gx += C2A * (f4 * y - f7 * z) - TWO * x * (C2B * f6 - C2C * f8)
        gy += C2A * (f4 * x - f5 * z) - TWO * y * (C2B * f6 + C2C * f8)
        gz += FOUR * C2B * f6 * z - C2A * (f5 * y + f7 * x)
    if degree > 2:
        f9, f10, f11, f12 = load8(f, 9 * LANES), load8(f, 10 * LANES), load8(f, 11 * LANES), load8(f, 12 * LANES)
        f13, f14, f15 = load8(f, 13 * LANES), load8(f, 14 * LANES), load8(f, 15 * LANES)
        xx, yy, zz = x * x, y * y, z * z
        gx += (TWO * C3C * f11 - SIX * C3A * f9) * x * y + C3B * f10 * y * z
        gx += (TWO * C3E * f14 - SIX * C3D * f12) * x * z - THREE * C3A * f15 * (xx - yy)
        gx += -C3C * f13 * (FOUR * zz - THREE * xx - yy)
        gy += -THREE * C3A * f9 * (xx - yy) + C3B * f10 * x * z
        gy += -C3C * f11 * (FOUR * zz - xx - THREE * yy)
        gy += (TWO * C3C * f13 + SIX * C3A * f15) * x * y
        gy += -(SIX * C3D * f12 + TWO * C3E * f14) * y * z
        gz += C3B * f10 * x * y - EIGHT * C3C * (f11 * y + f13 * x) * z
        gz += C3D * f12 * (SIX * zz - THREE * xx - THREE * yy) + C3E * f14 * (xx - yy)
    return gx, gy, gz


@internal(forceinline=True)
def prefetch_terms(sh_rest, rest, i):
    """Ask for the cache lines of Gaussian i's row of sh_rest."""
    for k in range(0, 3 * rest, _LINE):
        prefetch(sh_rest, 3 * rest * i + k)
    if rest > 0:
        prefetch(sh_rest, 3 * rest * i + 3 * rest - 1)


@internal(forceinline=True)
def put_columns(buffer, first, columns):
    """Write eight vectors to buffer[8 first : 8 (first + 8)]."""
    a, b, c, d, e, f, g, h = columns
    at = LANES * first
    store8(buffer, at, a)
    store8(buffer, at + LANES, b)
    store8(buffer, at + 2 * LANES, c)
    store8(buffer, at + 3 * LANES, d)
    store8(buffer, at + 4 * LANES, e)
    store8(buffer, at + 5 * LANES, f)
    store8(buffer, at + 6 * LANES, g)
    store8(buffer, at + 7 * LANES, h)


@internal(forceinline=True)
def get_columns(buffer, first):
    """The inverse of `put_columns`."""
    at = LANES * first
    return (
        load8(buffer, at), load8(buffer, at + LANES), load8(buffer, at + 2 * LANES), load8(buffer, at + 3 * LANES),
        load8(buffer, at + 4 * LANES), load8(buffer, at + 5 * LANES), load8(buffer, at + 6 * LANES),
        load8(buffer, at + 7 * LANES),
    )  # fmt: skip


@internal(forceinline=True)
def load_terms(sh_rest, rest, degree, rows, coefficients):
    """coefficients[8 k : 8 k + 8] = number k of eight Gaussians' rows of sh_rest, for the numbers up to `degree`."""
    width = 3 * rest
    for column in range(0, 3 * ((degree + 1) * (degree + 1) - 1), LANES):
        first = min(column, width - LANES)  # the last eight overlap those before
        put_columns(coefficients, first, load_rows8_at(sh_rest, rows, width, first))


@internal(forceinline=True)
def color8(sh_dc, sh_rest, rest, degree, rows, dx, dy, dz, basis, coefficients):
    """1/2 + the sum of the series of the Gaussians `rows` in direction (dx, dy, dz), any length; three channels, not
    clamped. basis and coefficients are working memory."""
    inverse = ONE / sqrt8(dx * dx + (dy * dy + dz * dz))
    fill_basis(basis, degree, dx * inverse, dy * inverse, dz * inverse)
    red, green, blue = (
        HALF + C0 * gather8_at(sh_dc, rows, 3, 0),
        HALF + C0 * gather8_at(sh_dc, rows, 3, 1),
        HALF + C0 * gather8_at(sh_dc, rows, 3, 2),
    )
    load_terms(sh_rest, rest, degree, rows, coefficients)
    for term in range(1, (degree + 1) * (degree + 1)):
        place = 3 * LANES * (term - 1)
        weight = load8(basis, term * LANES)
        red += weight * load8(coefficients, place)
        green += weight * load8(coefficients, place + LANES)
        blue += weight * load8(coefficients, place + 2 * LANES)
    return red, green, blue


@internal(forceinline=True)
def color_backward8(
    sh_rest, rest, degree, rows, dx, dy, dz, red, green, blue, d_dc, d_rest, basis, pulls, coefficients
):  # fmt: skip
    """Write the coefficients' gradients of the Gaussians `rows` from dL/d(colour); returns dL/d(dx, dy, dz).

    Coefficients beyond `degree` get zeros. basis, pulls and coefficients are working memory.
    """
    scatter8_at(d_dc, rows, 3, 0, C0 * red)
    scatter8_at(d_dc, rows, 3, 1, C0 * green)
    scatter8_at(d_dc, rows, 3, 2, C0 * blue)
    inverse = ONE / sqrt8(dx * dx + (dy * dy + dz * dz))
    x, y, z = dx * inverse, dy * inverse, dz * inverse
    fill_basis(basis, degree, x, y, z)
    load_terms(sh_rest, rest, degree, rows, coefficients)
    width, terms = 3 * rest, (degree + 1) * (degree + 1)
    for term in range(1, terms):
        place = 3 * LANES * (term - 1)
        weight = load8(basis, term * LANES)
        pull = load8(coefficients, place) * red + load8(coefficients, place + LANES) * green
        store8(pulls, term * LANES, pull + load8(coefficients, place + 2 * LANES) * blue)
        store8(coefficients, place, weight * red)
        store8(coefficients, place + LANES, weight * green)
        store8(coefficients, place + 2 * LANES, weight * blue)
    for place in range(3 * LANES * (terms - 1), LANES * width, LANES):
        store8(coefficients, place, splat8(ZERO))  # loaded with their neighbours
    for column in range(0, width, LANES):
        first = min(column, width - LANES)
        store_rows8_at(d_rest, rows, width, first, get_columns(coefficients, first))
    gx, gy, gz = direction_gradient(pulls, degree, x, y, z)
    # Backward through the normalisation: only the part perpendicular to the direction passes.
    along = x * gx + (y * gy + z * gz)
    return (gx - x * along) * inverse, (gy - y * along) * inverse, (gz - z * along) * inverse
