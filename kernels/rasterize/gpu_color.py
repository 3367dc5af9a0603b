"""Triton kernels of colour from spherical harmonics, 3DGS' real basis and its signs; one thread for each Gaussian.

They are kernels of their own because most Gaussians of a scene are outside the image, and colour is most of what is
known about one: only those that are visible are read.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import gpu_layout as layout
from .gpu_footprint import dot3, finite, load3, store3

_C0, _C1 = tl.constexpr(0.28209479177387814), tl.constexpr(0.4886025119029199)
_C2A, _C2B, _C2C = tl.constexpr(1.0925484305920792), tl.constexpr(0.31539156525252005), tl.constexpr(0.5462742152960396)
_C3A, _C3B = tl.constexpr(0.5900435899266435), tl.constexpr(2.890611442640554)
_C3C, _C3D = tl.constexpr(0.4570457994644658), tl.constexpr(0.3731763325901154)
_C3E = tl.constexpr(1.445305721320277)


@triton.jit
def direction_of(means, view, i, mask):
    """The unit direction from the camera to the Gaussian, and 1 / distance."""
    px, py, pz = load3(means, 3 * i, mask)
    eye = view + layout.CENTRE
    px, py, pz = px - tl.load(eye), py - tl.load(eye + 1), pz - tl.load(eye + 2)
    inverse = 1.0 / tl.sqrt(tl.where(mask, dot3(px, py, pz, px, py, pz), 1.0))
    return px * inverse, py * inverse, pz * inverse, inverse


@triton.jit
def harmonics(x, y, z):
    """The basis functions of degrees 1 to 3 in a unit direction."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        y * -_C1, z * _C1, x * -_C1, x * y * _C2A, y * z * -_C2A, (2.0 * zz - xx - yy) * _C2B, x * z * -_C2A,
        (xx - yy) * _C2C, y * (3.0 * xx - yy) * -_C3A, x * y * z * _C3B, y * (4.0 * zz - xx - yy) * -_C3C,
        z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * _C3D, x * (4.0 * zz - xx - yy) * -_C3C, z * (xx - yy) * _C3E,
        x * (xx - 3.0 * yy) * -_C3A,
    )  # fmt: skip


@triton.jit(do_not_specialize=["n"])
def color(
    means, sh_dc, sh_rest, view, visible, records, counts, n, views,
    REST: tl.constexpr, TERMS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the visible Gaussians' colours to their records: 1/2 + the series, clamped at 0 from below.

    REST: coefficients beyond the first that each Gaussian has; TERMS: how many of them are used.
    """
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    seen = tl.load(visible + i, mask=i < n, other=0) != 0
    red, green, blue = load3(sh_dc, 3 * i, seen)
    red, green, blue = 0.5 + red * _C0, 0.5 + green * _C0, 0.5 + blue * _C0
    if TERMS > 0:
        x, y, z, _ = direction_of(means, view, i, seen)
        basis = harmonics(x, y, z)
        row = i.to(tl.int64) * (3 * REST)
        for k in tl.static_range(TERMS):
            r, g, b = load3(sh_rest, row + 3 * k, seen)
            red, green, blue = red + basis[k] * r, green + basis[k] * g, blue + basis[k] * b
    bad = seen & ((finite(red) & finite(green) & finite(blue)) == 0)
    tl.store(counts + i * views, tl.zeros((BLOCK,), tl.int32) + layout.BAD, mask=bad)
    store3(
        records,
        i * layout.RECORD + layout.RED,
        tl.maximum(red, 0.0),
        tl.maximum(green, 0.0),
        tl.maximum(blue, 0.0),
        seen,
    )


@triton.jit
def direction_gradient(f, x, y, z, TERMS: tl.constexpr):
    """dL/d(unit direction) from dL/d(each basis function of degree 1 and more)."""
    gx, gy, gz = f[2] * -_C1, f[0] * -_C1, f[1] * _C1
    if TERMS > 3:
        gx += (f[3] * y - f[6] * z) * _C2A - 2.0 * x * (f[5] * _C2B - f[7] * _C2C)
        gy += (f[3] * x - f[4] * z) * _C2A - 2.0 * y * (f[5] * _C2B + f[7] * _C2C)
        gz += f[5] * z * (4.0 * _C2B) - (f[4] * y + f[6] * x) * _C2A
    if TERMS > 8:
        xx, yy, zz = x * x, y * y, z * z
        gx += (f[10] * (2.0 * _C3C) - f[8] * (6.0 * _C3A)) * x * y + f[9] * y * z * _C3B
        gx += (f[13] * (2.0 * _C3E) - f[11] * (6.0 * _C3D)) * x * z - f[14] * (xx - yy) * (3.0 * _C3A)
        gx -= f[12] * (4.0 * zz - 3.0 * xx - yy) * _C3C
        gy += f[9] * x * z * _C3B - f[8] * (xx - yy) * (3.0 * _C3A)
        gy -= f[10] * (4.0 * zz - xx - 3.0 * yy) * _C3C
        gy += (f[12] * (2.0 * _C3C) + f[14] * (6.0 * _C3A)) * x * y
        gy -= (f[13] * (2.0 * _C3E) + f[11] * (6.0 * _C3D)) * y * z
        gz += f[9] * x * y * _C3B - (f[10] * y + f[12] * x) * z * (8.0 * _C3C)
        gz += f[11] * (6.0 * zz - 3.0 * xx - 3.0 * yy) * _C3D + f[13] * (xx - yy) * _C3E
    return gx, gy, gz


@triton.jit(do_not_specialize=["n"])
def color_backward(
    means, sh_rest, view, visible, records, sums, d_means, d_dc, d_rest, n,
    SLOT: tl.constexpr, REST: tl.constexpr, TERMS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the coefficients' gradients from dL/d(colour), and add to the means' what comes by the direction.

    d_rest is zero before where TERMS < REST, and written for all Gaussians otherwise.
    """
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = i < n
    seen = tl.load(visible + i, mask=inside, other=0) != 0
    # A colour channel that was clamped at 0 passes no gradient on.
    red, green, blue = load3(records, i * layout.RECORD + layout.RED, seen)
    to_red, to_green, to_blue = load3(sums, i.to(tl.int64) * SLOT + layout.S_RED, seen)
    red = tl.where(red > 0.0, to_red, 0.0)
    green = tl.where(green > 0.0, to_green, 0.0)
    blue = tl.where(blue > 0.0, to_blue, 0.0)
    store3(d_dc, 3 * i, red * _C0, green * _C0, blue * _C0, inside)
    if TERMS > 0:
        x, y, z, inverse = direction_of(means, view, i, seen)
        basis = harmonics(x, y, z)
        row = i.to(tl.int64) * (3 * REST)
        pulls = ()
        for k in tl.static_range(TERMS):
            store3(d_rest, row + 3 * k, basis[k] * red, basis[k] * green, basis[k] * blue, inside)
            r, g, b = load3(sh_rest, row + 3 * k, seen)
            pulls = pulls + (r * red + g * green + b * blue,)  # type: ignore[assignment]  # it grows with each k
        gx, gy, gz = direction_gradient(pulls, x, y, z, TERMS)
        # Backward through the normalisation: only the part perpendicular to the direction passes.
        along = dot3(x, y, z, gx, gy, gz)
        before_x, before_y, before_z = load3(d_means, 3 * i, seen)
        store3(
            d_means, 3 * i, before_x + (gx - x * along) * inverse, before_y + (gy - y * along) * inverse,
            before_z + (gz - z * along) * inverse, seen,
        )  # fmt: skip
