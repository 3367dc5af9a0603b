"""A Gaussian seen by a pinhole, on a GPU: its place, axes, footprint and plane of largest density.

The forward and the backward pass of projection both compute them, so the backward pass keeps nothing.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import gpu_layout as layout


@triton.jit
def dot3(ax, ay, az, bx, by, bz):
    """Scalar product of two triples."""
    return ax * bx + (ay * by + az * bz)


@triton.jit
def finite(x):
    """Whether numbers are neither NaN nor infinite."""
    return tl.abs(x) < float("inf")


@triton.jit
def load3(array, at, mask):
    """Three numbers next to each other, zero where masked."""
    return (
        tl.load(array + at, mask=mask, other=0.0),
        tl.load(array + at + 1, mask=mask, other=0.0),
        tl.load(array + at + 2, mask=mask, other=0.0),
    )


@triton.jit
def store3(array, at, x, y, z, mask):
    """Write three numbers next to each other."""
    tl.store(array + at, x, mask=mask)
    tl.store(array + at + 1, y, mask=mask)
    tl.store(array + at + 2, z, mask=mask)


@triton.jit
def turned(view, x, y, z):
    """A vector of the world in the camera's axes."""
    r = view + layout.ROTATION
    return (
        dot3(tl.load(r), tl.load(r + 1), tl.load(r + 2), x, y, z),
        dot3(tl.load(r + 3), tl.load(r + 4), tl.load(r + 5), x, y, z),
        dot3(tl.load(r + 6), tl.load(r + 7), tl.load(r + 8), x, y, z),
    )


@triton.jit
def turned_back(view, x, y, z):
    """A vector of the camera in the world's axes."""
    r = view + layout.ROTATION
    return (
        dot3(tl.load(r), tl.load(r + 3), tl.load(r + 6), x, y, z),
        dot3(tl.load(r + 1), tl.load(r + 4), tl.load(r + 7), x, y, z),
        dot3(tl.load(r + 2), tl.load(r + 5), tl.load(r + 8), x, y, z),
    )


@triton.jit
def to_camera(view, x, y, z):
    """World position to camera position."""
    r = view + layout.ROTATION
    t = view + layout.TRANSLATION
    return (
        tl.load(r) * x + (tl.load(r + 1) * y + (tl.load(r + 2) * z + tl.load(t))),
        tl.load(r + 3) * x + (tl.load(r + 4) * y + (tl.load(r + 5) * z + tl.load(t + 1))),
        tl.load(r + 6) * x + (tl.load(r + 7) * y + (tl.load(r + 8) * z + tl.load(t + 2))),
    )


@triton.jit
def unit_quaternion(quaternions, i, mask):
    """The normalised quaternion (identity for a zero one) and 1 / norm (0 for a zero one)."""
    w = tl.load(quaternions + 4 * i, mask=mask, other=0.0)
    x, y, z = load3(quaternions, 4 * i + 1, mask)
    # Dividing by the largest component first keeps the squares from overflowing or underflowing.
    largest = tl.maximum(tl.maximum(tl.abs(w), tl.abs(x)), tl.maximum(tl.abs(y), tl.abs(z)))
    zero = largest == 0.0
    scale = 1.0 / tl.where(zero, 1.0, largest)
    w, x, y, z = w * scale, x * scale, y * scale, z * scale
    inverse = 1.0 / tl.sqrt(tl.where(zero, 1.0, w * w + x * x + (y * y + z * z)))
    w = tl.where(zero, 1.0, w * inverse)
    return w, x * inverse, y * inverse, z * inverse, tl.where(zero, 0.0, inverse * scale)


@triton.jit
def axes_of(view, w, x, y, z):
    """The Gaussian's three axes in camera coordinates, axis by axis: (m0x, m0y, m0z, m1x, …)."""
    m0x, m0y, m0z = turned(view, 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
    m1x, m1y, m1z = turned(view, 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x))
    m2x, m2y, m2z = turned(view, 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    return m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z


@triton.jit
def at_least(filtered, scale):
    """The filtered scale, but not less than the scale, whose square underflows in float32 below 1e-19. A NaN stays."""
    return tl.where(filtered < scale, scale, filtered)


@triton.jit
def sizes(log_scales, filter_3d, i, mask, FILTERED: tl.constexpr):
    """Per axis the scale s, and the filtered scale e = sqrt(s**2 + f**2): (s0, s1, s2, e0, e1, e2)."""
    s0, s1, s2 = load3(log_scales, 3 * i, mask)
    s0, s1, s2 = tl.exp(s0), tl.exp(s1), tl.exp(s2)
    if FILTERED:
        f = tl.load(filter_3d + i, mask=mask, other=0.0)
        f2 = f * f
        e0, e1 = at_least(tl.sqrt(s0 * s0 + f2), s0), at_least(tl.sqrt(s1 * s1 + f2), s1)
        e2 = at_least(tl.sqrt(s2 * s2 + f2), s2)
    else:
        e0, e1, e2 = s0, s1, s2
    return s0, s1, s2, e0, e1, e2


@triton.jit
def ratio(a, b):
    """a / b, with 0 / 0 = 1; a and b >= a are a scale before and after the 3D filter."""
    return tl.where(a == b, 1.0, a / b)


@triton.jit
def factors_of(view, iz, e0, e1, e2):
    """The Jacobian's diagonal times the filtered scales: (k0x, k1x, k2x, k0y, k1y, k2y)."""
    kx, ky = tl.load(view + layout.FX) * iz, tl.load(view + layout.FY) * iz
    return kx * e0, kx * e1, kx * e2, ky * e0, ky * e1, ky * e2


@triton.jit
def columns_of(k0x, k1x, k2x, k0y, k1y, k2y, m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z, cu, cv):
    """The columns of the factor A = J M diag(e) of the footprint's covariance A A^T: (a0x, a0y, a1x, …)."""
    return (
        k0x * (m0x - cu * m0z), k0y * (m0y - cv * m0z), k1x * (m1x - cu * m1z), k1y * (m1y - cv * m1z),
        k2x * (m2x - cu * m2z), k2y * (m2y - cv * m2z),
    )  # fmt: skip


@triton.jit
def covariance_of(a0x, a0y, a1x, a1y, a2x, a2y):
    """The covariance (sxx, sxy, syy), the minors of A (n01, n02, n12), and the sum of their squares, which is the
    covariance's determinant without cancellation."""
    n01, n02, n12 = minor(a0x, a0y, a1x, a1y), minor(a0x, a0y, a2x, a2y), minor(a1x, a1y, a2x, a2y)
    return (
        dot3(a0x, a1x, a2x, a0x, a1x, a2x), dot3(a0x, a1x, a2x, a0y, a1y, a2y), dot3(a0y, a1y, a2y, a0y, a1y, a2y), n01,
        n02, n12, dot3(n01, n02, n12, n01, n02, n12),
    )  # fmt: skip


@triton.jit
def minor(ax, ay, bx, by):
    """The determinant of a two by two block, ax by - ay bx."""
    # Kahan's difference of products. Left to itself the compiler would fuse one of the two products into the
    # difference, so that one is exact and the other rounded, and parallel columns have a minor that isn't zero.
    product = ay * bx
    lost = tl.fma(-ay, bx, product)
    return tl.fma(ax, by, -product) + lost


@triton.jit
def weights_of(e0, e1, e2):
    """(e_min / e_i)**2: the inverse covariance up to a factor that the plane doesn't depend on."""
    least = tl.minimum(e0, tl.minimum(e1, e2))
    w0, w1, w2 = ratio(least, e0), ratio(least, e1), ratio(least, e2)
    return w0 * w0, w1 * w1, w2 * w2


@triton.jit
def normal_of(m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z, b0, b1, b2, k0, k1, k2):
    """The normal h = sum of b_i m_i, up to a factor, of the plane of largest density along each ray (RaDe-GS, current
    version), h . r, and the length of h.

    k_i = m_i . r for the axes m and the ray r = (cu, cv, 1); b_i = w_i k_i with the weights of `weights_of`.
    """
    hx, hy, hz = dot3(b0, b1, b2, m0x, m1x, m2x), dot3(b0, b1, b2, m0y, m1y, m2y), dot3(b0, b1, b2, m0z, m1z, m2z)
    # h of a thin Gaussian that is seen along its plane is so short that its square underflows.
    largest = tl.maximum(tl.abs(hx), tl.maximum(tl.abs(hy), tl.abs(hz)))
    shrink = 1.0 / tl.where(largest > 0.0, largest, 1.0)
    x, y, z = hx * shrink, hy * shrink, hz * shrink
    return hx, hy, hz, dot3(b0, b1, b2, k0, k1, k2), largest * tl.sqrt(dot3(x, y, z, x, y, z))
