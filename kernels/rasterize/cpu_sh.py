"""Colour from spherical harmonics, eight Gaussians at a time; 3DGS' real basis and its signs.

Term k = 0 … 15 of the series lies at buffer[8 k : 8 k + 8].
"""

from __future__ import annotations

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd import LANES, select8, splat8
from dofbench.runtime.simd_functions import sqrt8
from dofbench.runtime.simd_memory import gather8, load8, scatter8, store8

TERMS = 16
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
def color8(sh_dc, sh_rest, rest, degree, i, dx, dy, dz, basis):
    """1/2 + the sum of the series in direction (dx, dy, dz), any length; three channels, not clamped."""
    inverse = ONE / sqrt8(dx * dx + (dy * dy + dz * dz))
    fill_basis(basis, degree, dx * inverse, dy * inverse, dz * inverse)
    red, green, blue = (
        HALF + C0 * gather8(sh_dc, 3 * i, 3),
        HALF + C0 * gather8(sh_dc, 3 * i + 1, 3),
        HALF + C0 * gather8(sh_dc, 3 * i + 2, 3),
    )
    stride = 3 * rest
    for term in range(1, (degree + 1) * (degree + 1)):
        place = stride * i + 3 * (term - 1)
        weight = load8(basis, term * LANES)
        red += weight * gather8(sh_rest, place, stride)
        green += weight * gather8(sh_rest, place + 1, stride)
        blue += weight * gather8(sh_rest, place + 2, stride)
    return red, green, blue


@internal(forceinline=True)
def color_backward8(sh_rest, rest, degree, i, seen, dx, dy, dz, red, green, blue, d_dc, d_rest, basis, pulls):
    """Write the coefficients' gradients from dL/d(colour); returns dL/d(dx, dy, dz).

    Lanes not `seen` and coefficients beyond `degree` get zeros. basis and pulls are working memory.
    """
    scatter8(d_dc, 3 * i, 3, C0 * red)
    scatter8(d_dc, 3 * i + 1, 3, C0 * green)
    scatter8(d_dc, 3 * i + 2, 3, C0 * blue)
    inverse = select8(seen, ONE / sqrt8(dx * dx + (dy * dy + dz * dz)), ZERO)
    x, y, z = dx * inverse, dy * inverse, dz * inverse
    fill_basis(basis, degree, x, y, z)
    stride = 3 * rest
    terms = (degree + 1) * (degree + 1)
    for term in range(1, rest + 1):
        place = stride * i + 3 * (term - 1)
        weight = load8(basis, term * LANES) if term < terms else splat8(ZERO)
        scatter8(d_rest, place, stride, weight * red)
        scatter8(d_rest, place + 1, stride, weight * green)
        scatter8(d_rest, place + 2, stride, weight * blue)
        pull = gather8(sh_rest, place, stride) * red + gather8(sh_rest, place + 1, stride) * green
        store8(pulls, term * LANES, pull + gather8(sh_rest, place + 2, stride) * blue)
    gx, gy, gz = direction_gradient(pulls, degree, x, y, z)
    # Backward through the normalisation: only the part perpendicular to the direction passes.
    along = x * gx + (y * gy + z * gz)
    return (gx - x * along) * inverse, (gy - y * along) * inverse, (gz - z * along) * inverse
