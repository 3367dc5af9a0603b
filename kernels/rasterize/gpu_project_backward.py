"""Triton kernels of projection's gradient: the sums over each Gaussian's intersections, always in the same order; and
from these to its raw parameters, one thread each."""

from __future__ import annotations

import triton
import triton.language as tl

from . import gpu_layout as layout
from .gpu_footprint import (
    axes_of,
    columns_of,
    covariance_of,
    dot3,
    factors_of,
    load3,
    normal_of,
    ratio,
    sizes,
    store3,
    to_camera,
    turned_back,
    unit_quaternion,
    weights_of,
)


@triton.jit
def quaternion_gradient(w, x, y, z, inverse, c0x, c0y, c0z, c1x, c1y, c1z, c2x, c2y, c2z):
    """dL/d(raw quaternion) from dL/d(rotation matrix) column by column; w … z normalised, inverse 1 / norm."""
    gw = 2.0 * (x * (c1z - c2y) + y * (c2x - c0z) + z * (c0y - c1x))
    gx = 2.0 * (y * (c0y + c1x) + z * (c0z + c2x) + w * (c1z - c2y) - 2.0 * x * (c1y + c2z))
    gy = 2.0 * (x * (c0y + c1x) + z * (c1z + c2y) + w * (c2x - c0z) - 2.0 * y * (c0x + c2z))
    gz = 2.0 * (x * (c0z + c2x) + y * (c1z + c2y) + w * (c0y - c1x) - 2.0 * z * (c0x + c1y))
    along = w * gw + x * gx + (y * gy + z * gz)
    return (
        (gw - w * along) * inverse,
        (gx - x * along) * inverse,
        (gy - y * along) * inverse,
        (gz - z * along) * inverse,
    )


@triton.jit
def clamped(value, low, high):
    """The value held between two bounds, and whether it lies between them and passes its gradient on."""
    free = (value > low) & (value < high)
    return tl.where(free, value, tl.where(value <= low, low, high)), free


@triton.jit(do_not_specialize=["n"])
def project_backward(
    means, log_scales, quaternions, opacity_logits, filter_3d, blur, view, visible, sums, d_means, d_scales,
    d_quaternions, d_logits, d_blur, d_radius, grad_2d, n,
    LEVEL: tl.constexpr, FADES: tl.constexpr, FILTERED: tl.constexpr, BLURRED: tl.constexpr, MOVED: tl.constexpr,
    STATISTICS: tl.constexpr, S_NORMAL: tl.constexpr, SLOT: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """The gradients of all but colour, zero for Gaussians that aren't visible.

    sums: (N, SLOT), see `gpu_layout`. LEVEL: of geometry that the loss uses. d_blur, d_radius and grad_2d may be
    anything unless BLURRED, MOVED and STATISTICS.
    """
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = i < n
    seen = tl.load(visible + i, mask=inside, other=0) != 0
    px, py, pz = load3(means, 3 * i, seen)
    x, y, z = to_camera(view, px, py, pz)
    # Threads of Gaussians that aren't seen compute with harmless numbers, and write zeros.
    x, y, z = tl.where(seen, x, 0.0), tl.where(seen, y, 0.0), tl.where(seen, z, 1.0)
    iz = 1.0 / z
    u, v = x * iz, y * iz
    cu, u_free = clamped(u, tl.load(view + layout.U_LOW), tl.load(view + layout.U_HIGH))
    cv, v_free = clamped(v, tl.load(view + layout.V_LOW), tl.load(view + layout.V_HIGH))

    qw, qx, qy, qz, inverse_norm = unit_quaternion(quaternions, i, seen)
    m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z = axes_of(view, qw, qx, qy, qz)
    s0, s1, s2, e0, e1, e2 = sizes(log_scales, filter_3d, i, seen, FILTERED)
    k0x, k1x, k2x, k0y, k1y, k2y = factors_of(view, iz, e0, e1, e2)
    a0x, a0y, a1x, a1y, a2x, a2y = columns_of(
        k0x, k1x, k2x, k0y, k1y, k2y, m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z, cu, cv
    )
    sxx, sxy, syy, n01, n02, n12, bare = covariance_of(a0x, a0y, a1x, a1y, a2x, a2y)
    filter_2d = tl.load(view + layout.FILTER_2D)
    det = tl.where(seen, bare + filter_2d * (sxx + syy + filter_2d), 1.0)
    wide, fyy = det, tl.where(seen, syy + filter_2d, 1.0)
    if BLURRED:
        extra = tl.load(blur + i, mask=seen, other=0.0)
        trace = sxx + syy + 2.0 * filter_2d
        wide, fyy = tl.where(seen, det + extra * (trace + extra), 1.0), fyy + extra

    # The inverse of the footprint's covariance is L L^T with L^T = [[l11, l21], [0, l22]].
    l11, l22 = tl.sqrt(fyy / wide), 1.0 / tl.sqrt(fyy)
    l21 = -sxy / tl.sqrt(fyy * wide)
    base = sums + i.to(tl.int64) * SLOT
    q0 = tl.load(base + layout.Q, mask=seen, other=0.0)
    q_x, q_y = tl.load(base + layout.QX, mask=seen, other=0.0), tl.load(base + layout.QY, mask=seen, other=0.0)
    q_xx, q_xy = tl.load(base + layout.QXX, mask=seen, other=0.0), tl.load(base + layout.QXY, mask=seen, other=0.0)
    q_yy = tl.load(base + layout.QYY, mask=seen, other=0.0)
    # Everything is in whitened coordinates, L^T (dx, dy), in which moments and axes are of order 1. Computing the
    # gradient with respect to the covariance instead would lose all digits for a long needle.
    n_x, n_y = l11 * q_x + l21 * q_y, l22 * q_y
    g_mx, g_my = l11 * n_x, l21 * n_x + l22 * n_y
    if MOVED:
        # dL/d(mean) is L L^T (Q_X, Q_Y) for each lens point; the sums hold its products with the points.
        along_x, across, along_y = load3(base, layout.S_T, seen)
        by_radius = l11 * l11 * along_x + l11 * l21 * across + (l21 * l21 + l22 * l22) * along_y
        tl.store(d_radius + i, by_radius, mask=inside)
    n_xx = l11 * (l11 * q_xx + l21 * q_xy) + l21 * (l11 * q_xy + l21 * q_yy)
    n_xy, n_yy = l22 * (l11 * q_xy + l21 * q_yy), l22 * l22 * q_yy
    w0x, w0y, w1x, w1y = l11 * a0x + l21 * a0y, l22 * a0y, l11 * a1x + l21 * a1y, l22 * a1y
    w2x, w2y = l11 * a2x + l21 * a2y, l22 * a2y
    v0x, v0y = n_xx * w0x + n_xy * w0y, n_xy * w0x + n_yy * w0y
    v1x, v1y = n_xx * w1x + n_xy * w1y, n_xy * w1x + n_yy * w1y
    v2x, v2y = n_xx * w2x + n_xy * w2y, n_xy * w2x + n_yy * w2y
    # b: dL/d(columns of A); g_e: dL/d(log of the filtered scales).
    b0x, b0y, b1x, b1y = l11 * v0x, l21 * v0x + l22 * v0y, l11 * v1x, l21 * v1x + l22 * v1y
    b2x, b2y = l11 * v2x, l21 * v2x + l22 * v2y
    g_e0, g_e1, g_e2 = w0x * v0x + w0y * v0y, w1x * v1x + w1y * v1y, w2x * v2x + w2y * v2y

    opacity = tl.sigmoid(tl.load(opacity_logits + i, mask=seen, other=0.0))
    tl.store(d_logits + i, q0 * (1.0 - opacity), mask=inside)
    if FADES or BLURRED:
        to_bare, to_trace = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
        if FADES:
            padded = det + layout.MIN_DETERMINANT
            share = bare / padded
            to_share = q0 / (share + layout.MIN_DETERMINANT)
            to_bare = to_share * (1.0 - share) / padded
            to_trace = -to_share * share / padded * filter_2d
        if BLURRED:
            # The gradient of the opacity's factor sqrt(det / wide), by the determinant and trace without blur. The
            # differences that make this term vanish without blur are computed analytically.
            by_both = q0 * extra / (det * wide)
            to_bare += by_both * (trace + extra)
            to_trace += by_both * (filter_2d * (filter_2d + extra) - bare)
            # The part that comes from the footprint is the trace of dL/d(covariance).
            widened = n_xx * (l11 * l11 + l21 * l21) + 2.0 * n_xy * (l21 * l22) + n_yy * (l22 * l22)
            tl.store(d_blur + i, 0.5 * (widened - q0 * (trace + 2.0 * extra) / wide), mask=inside)
        # The determinant is the sum of the squared minors.
        b0x, b0y = b0x + to_bare * (a1y * n01 + a2y * n02), b0y - to_bare * (a1x * n01 + a2x * n02)
        b1x, b1y = b1x + to_bare * (a2y * n12 - a0y * n01), b1y + to_bare * (a0x * n01 - a2x * n12)
        b2x, b2y = b2x - to_bare * (a0y * n02 + a1y * n12), b2y + to_bare * (a0x * n02 + a1x * n12)
        g_e0 += to_bare * (n01 * n01 + n02 * n02) + to_trace * (a0x * a0x + a0y * a0y)
        g_e1 += to_bare * (n01 * n01 + n12 * n12) + to_trace * (a1x * a1x + a1y * a1y)
        g_e2 += to_bare * (n02 * n02 + n12 * n12) + to_trace * (a2x * a2x + a2y * a2y)
        b0x, b0y, b1x, b1y = b0x + to_trace * a0x, b0y + to_trace * a0y, b1x + to_trace * a1x, b1y + to_trace * a1y
        b2x, b2y = b2x + to_trace * a2x, b2y + to_trace * a2y
    g_z = -(g_e0 + g_e1 + g_e2) * iz
    g0x, g0y, g1x, g1y, g2x, g2y = b0x * k0x, b0y * k0y, b1x * k1x, b1y * k1y, b2x * k2x, b2y * k2y
    g0z, g1z, g2z = -(cu * g0x + cv * g0y), -(cu * g1x + cv * g1y), -(cu * g2x + cv * g2y)
    g_u, g_v = -dot3(g0x, g1x, g2x, m0z, m1z, m2z), -dot3(g0y, g1y, g2y, m0z, m1z, m2z)
    g_x, g_y = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)

    if LEVEL > 0:
        w0, w1, w2 = weights_of(e0, e1, e2)
        k0, k1, k2 = m0x * cu + (m0y * cv + m0z), m1x * cu + (m1y * cv + m1z), m2x * cu + (m2y * cv + m2z)
        b0, b1, b2 = w0 * k0, w1 * k1, w2 * k2
        hx, hy, hz, along, length = normal_of(m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z, b0, b1, b2, k0, k1, k2)
        fx, fy = tl.load(view + layout.FX), tl.load(view + layout.FY)
        plane = seen & (along > length * layout.EDGE_ON)
        ia = tl.where(plane, 1.0 / along, 0.0)
        ig = 1.0 / (cu * cu + (cv * cv + 1.0))
        distance = tl.sqrt(dot3(x, y, z, x, y, z))
        sum_t, sum_tx, sum_ty = load3(base, layout.S_T, seen)
        g_tx, g_ty = -sum_tx, -sum_ty
        slope_x = tl.where(plane, (hx * ia - cu * ig) / fx, 0.0)
        slope_y = tl.where(plane, (hy * ia - cv * ig) / fy, 0.0)
        g_mx += distance * slope_x * sum_t
        g_my += distance * slope_y * sum_t
        g_distance = (sum_t + g_tx * slope_x + g_ty * slope_y) / distance
        g_x += g_distance * x
        g_y += g_distance * y
        g_z += g_distance * z
        # m = h / (r . h), slope = (m - r / |r|**2) / focal length, in x and y; r = (cu, cv, 1).
        p_x, p_y = tl.where(plane, g_tx * distance / fx, 0.0), tl.where(plane, g_ty * distance / fy, 0.0)
        pull = 2.0 * (p_x * cu + p_y * cv) * ig * ig
        g_u += pull * cu - p_x * ig
        g_v += pull * cv - p_y * ig
        h_x, h_y = p_x * ia, p_y * ia
        g_along = -(h_x * hx + h_y * hy) * ia
        g_u += g_along * hx
        g_v += g_along * hy
        h_x, h_y, h_z = h_x + g_along * cu, h_y + g_along * cv, g_along
        if LEVEL > 1:
            il = tl.where(plane, 1.0 / length, 0.0)
            nx, ny, nz = hx * il, hy * il, hz * il
            to_nx, to_ny, to_nz = load3(base, S_NORMAL, seen)
            radial = dot3(nx, ny, nz, to_nx, to_ny, to_nz)
            h_x += (nx * radial - to_nx) * il
            h_y += (ny * radial - to_ny) * il
            h_z += (nz * radial - to_nz) * il
        # h = sum of w_i k_i m_i with k_i = m_i . r.
        t0, t1 = dot3(h_x, h_y, h_z, m0x, m0y, m0z), dot3(h_x, h_y, h_z, m1x, m1y, m1z)
        t2 = dot3(h_x, h_y, h_z, m2x, m2y, m2z)
        g_e0 -= 2.0 * w0 * k0 * t0
        g_e1 -= 2.0 * w1 * k1 * t1
        g_e2 -= 2.0 * w2 * k2 * t2
        c0, c1, c2 = w0 * t0, w1 * t1, w2 * t2
        g0x, g0y, g0z = g0x + b0 * h_x + c0 * cu, g0y + b0 * h_y + c0 * cv, g0z + b0 * h_z + c0
        g1x, g1y, g1z = g1x + b1 * h_x + c1 * cu, g1y + b1 * h_y + c1 * cv, g1z + b1 * h_z + c1
        g2x, g2y, g2z = g2x + b2 * h_x + c2 * cu, g2y + b2 * h_y + c2 * cv, g2z + b2 * h_z + c2
        g_u += dot3(c0, c1, c2, m0x, m1x, m2x)
        g_v += dot3(c0, c1, c2, m0y, m1y, m2y)

    if STATISTICS:
        tl.store(grad_2d + 2 * i, g_mx, mask=inside)
        tl.store(grad_2d + 2 * i + 1, g_my, mask=inside)
    g_u = tl.where(u_free, g_u, 0.0) + g_mx * tl.load(view + layout.FX)
    g_v = tl.where(v_free, g_v, 0.0) + g_my * tl.load(view + layout.FY)
    g_x += g_u * iz
    g_y += g_v * iz
    g_z -= (g_u * u + g_v * v) * iz
    to_x, to_y, to_z = turned_back(view, g_x, g_y, g_z)
    zero = tl.zeros((BLOCK,), tl.float32)
    store3(d_means, 3 * i, tl.where(seen, to_x, zero), tl.where(seen, to_y, zero), tl.where(seen, to_z, zero), inside)

    # Log scales: through the filtered scale, and through the opacity's factor s / e.
    r0, r1, r2 = ratio(s0, e0), ratio(s1, e1), ratio(s2, e2)
    r0, r1, r2 = r0 * r0, r1 * r1, r2 * r2
    by_0, by_1, by_2 = g_e0 * r0 + q0 * (1.0 - r0), g_e1 * r1 + q0 * (1.0 - r1), g_e2 * r2 + q0 * (1.0 - r2)
    store3(d_scales, 3 * i, tl.where(seen, by_0, zero), tl.where(seen, by_1, zero), tl.where(seen, by_2, zero), inside)

    c0x, c0y, c0z = turned_back(view, g0x, g0y, g0z)
    c1x, c1y, c1z = turned_back(view, g1x, g1y, g1z)
    c2x, c2y, c2z = turned_back(view, g2x, g2y, g2z)
    g_w, g_i, g_j, g_k = quaternion_gradient(qw, qx, qy, qz, inverse_norm, c0x, c0y, c0z, c1x, c1y, c1z, c2x, c2y, c2z)
    tl.store(d_quaternions + 4 * i, tl.where(seen, g_w, zero), mask=inside)
    store3(
        d_quaternions, 4 * i + 1, tl.where(seen, g_i, zero), tl.where(seen, g_j, zero), tl.where(seen, g_k, zero),
        inside,
    )  # fmt: skip


@triton.jit(do_not_specialize=["n"])
def sum_slots(
    slots, order, ends, sums, n, views,
    SLOT: tl.constexpr, COLUMNS: tl.constexpr, GAUSSIANS: tl.constexpr, ROWS: tl.constexpr,
):  # fmt: skip
    """The sum of each Gaussian's slots, which are adjacent; a group of Gaussians in each program.

    slots: (intersections, SLOT). order, ends: as in `gpu_tiles.fill`. sums: (N, SLOT). COLUMNS: SLOT rounded up to a
    power of two. ROWS: of a Gaussian's slots that are read at once, so that the sum over a wide Gaussian's thousands of
    intersections doesn't wait for memory that often.
    """
    rank = tl.program_id(0) * GAUSSIANS + tl.arange(0, GAUSSIANS)
    inside = rank < n
    i = tl.load(order + rank, mask=inside, other=0)
    begin = tl.load(ends + rank * views - 1, mask=inside & (rank > 0), other=0)
    many = (tl.load(ends + rank * views + (views - 1), mask=inside, other=0) - begin).to(tl.int32)
    row, column = tl.arange(0, ROWS)[None, :, None], tl.arange(0, COLUMNS)[None, None, :]
    total = tl.zeros((GAUSSIANS, ROWS, COLUMNS), tl.float32)
    for first in range(0, tl.max(many, 0), ROWS):
        inner = (first + row < many[:, None, None]) & (column < SLOT)
        total += tl.load(slots + (begin[:, None, None] + first + row) * SLOT + column, mask=inner, other=0.0)
    where = sums + i[:, None] * SLOT + tl.arange(0, COLUMNS)[None, :]
    tl.store(where, tl.sum(total, 1), mask=inside[:, None] & (tl.arange(0, COLUMNS)[None, :] < SLOT))
