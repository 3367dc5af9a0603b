"""A Gaussian seen by a pinhole: its place, axes, footprint and plane of largest density, for eight at a time.

The forward and the backward pass of projection both compute them, so the backward pass keeps nothing.
"""

from __future__ import annotations

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd import select8
from dofbench.runtime.simd_functions import abs8, exp8, max8, min8, sqrt8

from . import cpu_layout as layout

ONE = np.float32(1.0)
ZERO = np.float32(0.0)
SQUARES_UNDERFLOW = np.float32(1e-15)  # numbers below it have squares of less than 1e-30, whose last digits are lost


@internal(forceinline=True)
def dot3(ax, ay, az, bx, by, bz):
    """Scalar product of two triples."""
    return ax * bx + (ay * by + az * bz)


@internal(forceinline=True)
def to_camera8(view, x, y, z):
    """World position to camera position."""
    r = layout.ROTATION
    t = layout.TRANSLATION
    return (
        view[r] * x + (view[r + 1] * y + (view[r + 2] * z + view[t])),
        view[r + 3] * x + (view[r + 4] * y + (view[r + 5] * z + view[t + 1])),
        view[r + 6] * x + (view[r + 7] * y + (view[r + 8] * z + view[t + 2])),
    )


@internal(forceinline=True)
def unit_quaternion8(w, x, y, z):
    """The normalised quaternion (identity for a zero one) and 1 / norm (0 for a zero one)."""
    # Dividing by the largest component first keeps the squares from overflowing or underflowing.
    largest = max8(max8(abs8(w), abs8(x)), max8(abs8(y), abs8(z)))
    zero = largest == ZERO
    scale = ONE / select8(zero, ONE, largest)
    w, x, y, z = w * scale, x * scale, y * scale, z * scale
    inverse = ONE / sqrt8(select8(zero, ONE, w * w + x * x + (y * y + z * z)))
    w = select8(zero, ONE, w * inverse)
    return w, x * inverse, y * inverse, z * inverse, select8(zero, ZERO, inverse * scale)


@internal(forceinline=True)
def axes8(view, w, x, y, z):
    """The Gaussian's three axes in camera coordinates, axis by axis: (m0x, m0y, m0z, m1x, …)."""
    two = np.float32(2.0)
    c0x, c0y, c0z = ONE - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)
    c1x, c1y, c1z = two * (x * y - w * z), ONE - two * (x * x + z * z), two * (y * z + w * x)
    c2x, c2y, c2z = two * (x * z + w * y), two * (y * z - w * x), ONE - two * (x * x + y * y)
    r00, r01, r02 = view[layout.ROTATION], view[layout.ROTATION + 1], view[layout.ROTATION + 2]
    r10, r11, r12 = view[layout.ROTATION + 3], view[layout.ROTATION + 4], view[layout.ROTATION + 5]
    r20, r21, r22 = view[layout.ROTATION + 6], view[layout.ROTATION + 7], view[layout.ROTATION + 8]
    return (
        r00 * c0x + (r01 * c0y + r02 * c0z), r10 * c0x + (r11 * c0y + r12 * c0z), r20 * c0x + (r21 * c0y + r22 * c0z),
        r00 * c1x + (r01 * c1y + r02 * c1z), r10 * c1x + (r11 * c1y + r12 * c1z), r20 * c1x + (r21 * c1y + r22 * c1z),
        r00 * c2x + (r01 * c2y + r02 * c2z), r10 * c2x + (r11 * c2y + r12 * c2z), r20 * c2x + (r21 * c2y + r22 * c2z),
    )  # fmt: skip


@internal(forceinline=True)
def sizes8(log0, log1, log2, filtered, f):
    """Per axis the scale s, and the filtered scale e = sqrt(s**2 + f**2), or s unless `filtered`: (s0, s1, s2, e0, e1,
    e2)."""
    s0, s1, s2 = exp8(log0), exp8(log1), exp8(log2)
    if not filtered:
        return s0, s1, s2, s0, s1, s2
    f2 = f * f
    # The square of a scale below 1e-19 underflows in float32; the filtered scale must not become smaller than the
    # scale. In this order a NaN of the filter reaches the check of what is projected.
    return s0, s1, s2, max8(s0, sqrt8(s0 * s0 + f2)), max8(s1, sqrt8(s1 * s1 + f2)), max8(s2, sqrt8(s2 * s2 + f2))


@internal(forceinline=True)
def ratio8(a, b):
    """a / b, with 0 / 0 = 1; a and b >= a are a scale before and after the 3D filter."""
    return select8(a == b, ONE, a / b)


@internal(forceinline=True)
def minor8(ax, ay, bx, by):
    """The determinant of a two by two block, ax by - ay bx."""
    return ax * by - ay * bx


@internal(forceinline=True)
def weights8(e0, e1, e2):
    """(e_min / e_i)**2: the inverse covariance up to a factor that the plane doesn't depend on."""
    least = min8(e0, min8(e1, e2))
    w0, w1, w2 = ratio8(least, e0), ratio8(least, e1), ratio8(least, e2)
    return w0 * w0, w1 * w1, w2 * w2


@internal(forceinline=True)
def footprint8(view, axes, filtered, iz, cu, cv):
    """The factor A = J M diag(e) of the footprint's covariance A A^T, and the quantities derived from it.

    axes: of `axes8`. filtered: (e0, e1, e2). Returns J's diagonal times e (k0x, k1x, k2x, k0y, k1y, k2y), the columns
    of A (a0x, a0y, a1x, …), the covariance (sxx, sxy, syy), the minors of A (n01, n02, n12), and the sum of their
    squares, which is the covariance's determinant without cancellation.
    """
    m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z = axes
    e0, e1, e2 = filtered
    kx, ky = view[layout.FX] * iz, view[layout.FY] * iz
    k0x, k1x, k2x, k0y, k1y, k2y = kx * e0, kx * e1, kx * e2, ky * e0, ky * e1, ky * e2
    a0x, a0y = k0x * (m0x - cu * m0z), k0y * (m0y - cv * m0z)
    a1x, a1y = k1x * (m1x - cu * m1z), k1y * (m1y - cv * m1z)
    a2x, a2y = k2x * (m2x - cu * m2z), k2y * (m2y - cv * m2z)
    sxx, sxy = dot3(a0x, a1x, a2x, a0x, a1x, a2x), dot3(a0x, a1x, a2x, a0y, a1y, a2y)
    syy = dot3(a0y, a1y, a2y, a0y, a1y, a2y)
    n01, n02, n12 = minor8(a0x, a0y, a1x, a1y), minor8(a0x, a0y, a2x, a2y), minor8(a1x, a1y, a2x, a2y)
    return (
        (k0x, k1x, k2x, k0y, k1y, k2y),
        (a0x, a0y, a1x, a1y, a2x, a2y),
        (sxx, sxy, syy),
        (n01, n02, n12),
        dot3(n01, n02, n12, n01, n02, n12),
    )


@internal(forceinline=True)
def plane8(axes, filtered, cu, cv):
    """The plane of largest density along each ray (RaDe-GS, current version), given by its normal h up to a factor.

    Returns the weights w of the axes m up to that factor, k_i = m_i . r with the ray r = (cu, cv, 1), w_i k_i,
    h = sum of w_i k_i m_i, h . r and the length of h.
    """
    m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z = axes
    e0, e1, e2 = filtered
    w0, w1, w2 = weights8(e0, e1, e2)
    k0, k1, k2 = m0x * cu + (m0y * cv + m0z), m1x * cu + (m1y * cv + m1z), m2x * cu + (m2y * cv + m2z)
    # Seen exactly along its plane, a thin Gaussian has only tiny w_i k_i. Their squares underflow in float32 unless the
    # weights are enlarged first.
    largest = max8(abs8(w0 * k0), max8(abs8(w1 * k1), abs8(w2 * k2)))
    factor = select8((largest > ZERO) & (largest < SQUARES_UNDERFLOW), ONE / largest, ONE)
    w0, w1, w2 = w0 * factor, w1 * factor, w2 * factor
    b0, b1, b2 = w0 * k0, w1 * k1, w2 * k2
    hx, hy, hz = dot3(b0, b1, b2, m0x, m1x, m2x), dot3(b0, b1, b2, m0y, m1y, m2y), dot3(b0, b1, b2, m0z, m1z, m2z)
    along = dot3(b0, b1, b2, k0, k1, k2)
    return (w0, w1, w2), (k0, k1, k2), (b0, b1, b2), (hx, hy, hz), along, sqrt8(dot3(hx, hy, hz, hx, hy, hz))
