"""Colour from spherical harmonics, eight Gaussians at a time; 3DGS' real basis and its signs."""

from __future__ import annotations

import numpy as np
from numba import njit

from dofbench.numba_math import gather8, scatter8, select8, splat8, sqrt8

C0 = np.float32(0.28209479177387814)
C1 = np.float32(0.4886025119029199)
C2A, C2B, C2C = np.float32(1.0925484305920792), np.float32(0.31539156525252005), np.float32(0.5462742152960396)
C3A, C3B, C3C = np.float32(0.5900435899266435), np.float32(2.890611442640554), np.float32(0.4570457994644658)
C3D, C3E = np.float32(0.3731763325901154), np.float32(1.445305721320277)
ONE, TWO, THREE = np.float32(1.0), np.float32(2.0), np.float32(3.0)
FOUR, FIVE, SIX, EIGHT = np.float32(4.0), np.float32(5.0), np.float32(6.0), np.float32(8.0)
HALF = np.float32(0.5)
ZERO = np.float32(0.0)


@njit(forceinline=True)
def basis2(x, y, z):
    """The five functions of degree 2."""
    return (C2A * x * y, -C2A * y * z, C2B * (TWO * z * z - x * x - y * y), -C2A * x * z, C2C * (x * x - y * y))


@njit(forceinline=True)
def basis3(x, y, z):
    """The seven functions of degree 3."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        -C3A * y * (THREE * xx - yy), C3B * x * y * z, -C3C * y * (FOUR * zz - xx - yy),
        C3D * z * (TWO * zz - THREE * xx - THREE * yy), -C3C * x * (FOUR * zz - xx - yy), C3E * z * (xx - yy),
        -C3A * x * (xx - THREE * yy),
    )


@njit(forceinline=True)
def add3(total, weight, coefficients, start, stride):
    """total + weight * (the three channels of one coefficient)."""
    return (total[0] + weight * gather8(coefficients, start, stride),
            total[1] + weight * gather8(coefficients, start + 1, stride),
            total[2] + weight * gather8(coefficients, start + 2, stride))


@njit(forceinline=True)
def color8(sh_dc, sh_rest, rest, degree, i, dx, dy, dz):
    """1/2 + the sum of the series in direction (dx, dy, dz), any length; three channels, not clamped."""
    dc = 3 * i
    total = (HALF + C0 * gather8(sh_dc, dc, 3), HALF + C0 * gather8(sh_dc, dc + 1, 3),
             HALF + C0 * gather8(sh_dc, dc + 2, 3))
    if degree > 0:
        inverse = ONE / sqrt8(dx * dx + (dy * dy + dz * dz))
        x, y, z = dx * inverse, dy * inverse, dz * inverse
        stride = 3 * rest
        start = stride * i
        total = add3(total, -C1 * y, sh_rest, start, stride)
        total = add3(total, C1 * z, sh_rest, start + 3, stride)
        total = add3(total, -C1 * x, sh_rest, start + 6, stride)
        if degree > 1:
            b = basis2(x, y, z)
            total = add3(total, b[0], sh_rest, start + 9, stride)
            total = add3(total, b[1], sh_rest, start + 12, stride)
            total = add3(total, b[2], sh_rest, start + 15, stride)
            total = add3(total, b[3], sh_rest, start + 18, stride)
            total = add3(total, b[4], sh_rest, start + 21, stride)
        if degree > 2:
            c = basis3(x, y, z)
            total = add3(total, c[0], sh_rest, start + 24, stride)
            total = add3(total, c[1], sh_rest, start + 27, stride)
            total = add3(total, c[2], sh_rest, start + 30, stride)
            total = add3(total, c[3], sh_rest, start + 33, stride)
            total = add3(total, c[4], sh_rest, start + 36, stride)
            total = add3(total, c[5], sh_rest, start + 39, stride)
            total = add3(total, c[6], sh_rest, start + 42, stride)
    return total


@njit(forceinline=True)
def put3(out, start, stride, weight, g):
    """Write one coefficient's gradient, weight * g for each channel."""
    scatter8(out, start, stride, weight * g[0])
    scatter8(out, start + 1, stride, weight * g[1])
    scatter8(out, start + 2, stride, weight * g[2])


@njit(forceinline=True)
def pull3(coefficients, start, stride, g):
    """The gradient by a coefficient's basis function: coefficient . g over the channels."""
    return (gather8(coefficients, start, stride) * g[0] + gather8(coefficients, start + 1, stride) * g[1]
            + gather8(coefficients, start + 2, stride) * g[2])


@njit(forceinline=True)
def direction_backward2(x, y, z, f0, f1, f2, f3, f4):
    """dL/d(direction) from dL/d(the five functions of degree 2)."""
    gx = C2A * (f0 * y - f3 * z) - TWO * x * (C2B * f2 - C2C * f4)
    gy = C2A * (f0 * x - f1 * z) - TWO * y * (C2B * f2 + C2C * f4)
    gz = FOUR * C2B * f2 * z - C2A * (f1 * y + f3 * x)
    return gx, gy, gz


@njit(forceinline=True)
def direction_backward3(x, y, z, f0, f1, f2, f3, f4, f5, f6):
    """dL/d(direction) from dL/d(the seven functions of degree 3)."""
    xx, yy, zz = x * x, y * y, z * z
    gx = (-SIX * C3A * f0 * x * y + C3B * f1 * y * z + TWO * C3C * f2 * x * y - SIX * C3D * f3 * x * z
          - C3C * f4 * (FOUR * zz - THREE * xx - yy) + TWO * C3E * f5 * x * z - THREE * C3A * f6 * (xx - yy))
    gy = (-THREE * C3A * f0 * (xx - yy) + C3B * f1 * x * z - C3C * f2 * (FOUR * zz - xx - THREE * yy)
          - SIX * C3D * f3 * y * z + TWO * C3C * f4 * x * y - TWO * C3E * f5 * y * z + SIX * C3A * f6 * x * y)
    gz = (C3B * f1 * x * y - EIGHT * C3C * f2 * y * z + C3D * f3 * (SIX * zz - THREE * xx - THREE * yy)
          - EIGHT * C3C * f4 * x * z + C3E * f5 * (xx - yy))
    return gx, gy, gz


@njit(forceinline=True)
def color_backward8(sh_dc, sh_rest, rest, degree, i, seen, dx, dy, dz, red, green, blue, d_dc, d_rest, out):
    """Write the coefficients' gradients; returns dL/d(dx, dy, dz). Lanes not `seen` get zeros.

    A channel that was clamped at 0 passes nothing on, and coefficients beyond `degree` get zeros.
    """
    value = color8(sh_dc, sh_rest, rest, degree, i, dx, dy, dz)
    g = (select8(seen & (value[0] > ZERO), red, ZERO), select8(seen & (value[1] > ZERO), green, ZERO),
         select8(seen & (value[2] > ZERO), blue, ZERO))
    scatter8(d_dc, 3 * out, 3, C0 * g[0])
    scatter8(d_dc, 3 * out + 1, 3, C0 * g[1])
    scatter8(d_dc, 3 * out + 2, 3, C0 * g[2])
    gx, gy, gz = splat8(ZERO), splat8(ZERO), splat8(ZERO)
    stride = 3 * rest
    start, place = stride * i, stride * out
    inverse = select8(seen, ONE / sqrt8(dx * dx + (dy * dy + dz * dz)), ZERO)
    x, y, z = dx * inverse, dy * inverse, dz * inverse
    if degree > 0:
        put3(d_rest, place, stride, -C1 * y, g)
        put3(d_rest, place + 3, stride, C1 * z, g)
        put3(d_rest, place + 6, stride, -C1 * x, g)
        gy += -C1 * pull3(sh_rest, start, stride, g)
        gz += C1 * pull3(sh_rest, start + 3, stride, g)
        gx += -C1 * pull3(sh_rest, start + 6, stride, g)
    if degree > 1:
        b = basis2(x, y, z)
        put3(d_rest, place + 9, stride, b[0], g)
        put3(d_rest, place + 12, stride, b[1], g)
        put3(d_rest, place + 15, stride, b[2], g)
        put3(d_rest, place + 18, stride, b[3], g)
        put3(d_rest, place + 21, stride, b[4], g)
        p = direction_backward2(
            x, y, z, pull3(sh_rest, start + 9, stride, g), pull3(sh_rest, start + 12, stride, g),
            pull3(sh_rest, start + 15, stride, g), pull3(sh_rest, start + 18, stride, g),
            pull3(sh_rest, start + 21, stride, g))
        gx, gy, gz = gx + p[0], gy + p[1], gz + p[2]
    if degree > 2:
        c = basis3(x, y, z)
        put3(d_rest, place + 24, stride, c[0], g)
        put3(d_rest, place + 27, stride, c[1], g)
        put3(d_rest, place + 30, stride, c[2], g)
        put3(d_rest, place + 33, stride, c[3], g)
        put3(d_rest, place + 36, stride, c[4], g)
        put3(d_rest, place + 39, stride, c[5], g)
        put3(d_rest, place + 42, stride, c[6], g)
        r = direction_backward3(
            x, y, z, pull3(sh_rest, start + 24, stride, g), pull3(sh_rest, start + 27, stride, g),
            pull3(sh_rest, start + 30, stride, g), pull3(sh_rest, start + 33, stride, g),
            pull3(sh_rest, start + 36, stride, g), pull3(sh_rest, start + 39, stride, g),
            pull3(sh_rest, start + 42, stride, g))
        gx, gy, gz = gx + r[0], gy + r[1], gz + r[2]
    used = (degree + 1) * (degree + 1) - 1
    for k in range(used, rest):
        scatter8(d_rest, place + 3 * k, stride, splat8(ZERO))
        scatter8(d_rest, place + 3 * k + 1, stride, splat8(ZERO))
        scatter8(d_rest, place + 3 * k + 2, stride, splat8(ZERO))
    # Through the normalisation: only what is perpendicular to the direction passes.
    along = x * gx + (y * gy + z * gz)
    return (gx - x * along) * inverse, (gy - y * along) * inverse, (gz - z * along) * inverse
