"""The gradient of projection for eight Gaussians: from their sums over pixels to their raw parameters."""

from __future__ import annotations

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd import LANES, select8, splat8
from dofbench.runtime.simd_functions import exp8, sqrt8
from dofbench.runtime.simd_memory import gather8, store8
from dofbench.runtime.simd_rows import gather8_at, load_rows8, scatter8_at

from . import cpu_layout as layout
from .cpu_footprint import ONE, ZERO, axes8, dot3, footprint8, plane8, ratio8, sizes8, to_camera8, unit_quaternion8
from .cpu_sh import color_backward8

HALF = np.float32(0.5)
TWO = np.float32(2.0)
SLOT = layout.SLOT


@internal(forceinline=True)
def quaternion_backward8(w, x, y, z, inverse, g):
    """dL/d(raw quaternion) from dL/d(rotation matrix), g column by column; w … z normalised, inverse 1 / norm."""
    c0x, c0y, c0z, c1x, c1y, c1z, c2x, c2y, c2z = g
    gw = TWO * (x * (c1z - c2y) + y * (c2x - c0z) + z * (c0y - c1x))
    gx = TWO * (y * (c0y + c1x) + z * (c0z + c2x) + w * (c1z - c2y) - TWO * x * (c1y + c2z))
    gy = TWO * (x * (c0y + c1x) + z * (c1z + c2y) + w * (c2x - c0z) - TWO * y * (c0x + c2z))
    gz = TWO * (x * (c0z + c2x) + y * (c1z + c2y) + w * (c0y - c1x) - TWO * z * (c0x + c1y))
    along = w * gw + x * gx + (y * gy + z * gz)
    return (
        (gw - w * along) * inverse,
        (gx - x * along) * inverse,
        (gy - y * along) * inverse,
        (gz - z * along) * inverse,
    )


@internal(error_model="numpy")
def backward_rows(
    inputs, rest, degree, geometry, view, records, rows, sums, outputs, grad_2d, basis, pulls, coefficients
):  # fmt: skip
    """Gradients of eight Gaussians, given by their indices; one may stand there several times.

    sums: (8, SLOT), flat, the sums over each one's intersections. grad_2d: (2, 8), flat, filled in: the gradient with
    respect to the mean in the image. basis, pulls and coefficients are working memory.
    """
    means, log_scales, quaternions, opacity_logits, _, sh_rest, filter_3d, blur, _ = inputs
    d_means, d_scales, d_quaternions, d_logits, d_dc, d_rest, d_blur, d_radius = outputs
    q0, q_x, q_xx, q_y, q_xy, q_yy, sum_red, sum_green = load_rows8(sums, 0, SLOT)
    sum_blue, sum_t, sum_tx, sum_ty, _, _, to_nx, to_ny = load_rows8(sums, LANES, SLOT)
    to_nz = gather8(sums, layout.S_NZ, SLOT)
    px, py, pz = gather8_at(means, rows, 3, 0), gather8_at(means, rows, 3, 1), gather8_at(means, rows, 3, 2)
    x, y, z = to_camera8(view, px, py, pz)
    fx, fy = view[layout.FX], view[layout.FY]
    iz = ONE / z
    u, v = x * iz, y * iz
    u_free = (u > view[layout.U_LOW]) & (u < view[layout.U_HIGH])
    v_free = (v > view[layout.V_LOW]) & (v < view[layout.V_HIGH])
    cu = select8(u_free, u, select8(u <= view[layout.U_LOW], view[layout.U_LOW], view[layout.U_HIGH]))
    cv = select8(v_free, v, select8(v <= view[layout.V_LOW], view[layout.V_LOW], view[layout.V_HIGH]))

    w, qx = gather8_at(quaternions, rows, 4, 0), gather8_at(quaternions, rows, 4, 1)
    qy, qz = gather8_at(quaternions, rows, 4, 2), gather8_at(quaternions, rows, 4, 3)
    w, qx, qy, qz, inverse_norm = unit_quaternion8(w, qx, qy, qz)
    axes = axes8(view, w, qx, qy, qz)
    m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z = axes
    log0, log1 = gather8_at(log_scales, rows, 3, 0), gather8_at(log_scales, rows, 3, 1)
    log2 = gather8_at(log_scales, rows, 3, 2)
    filtered = filter_3d.size > 0
    size = gather8_at(filter_3d, rows, 1, 0) if filtered else splat8(ZERO)
    s0, s1, s2, e0, e1, e2 = sizes8(log0, log1, log2, filtered, size)
    factors, columns, (sxx, sxy, syy), (n01, n02, n12), det_bare = footprint8(view, axes, (e0, e1, e2), iz, cu, cv)
    k0x, k1x, k2x, k0y, k1y, k2y = factors
    a0x, a0y, a1x, a1y, a2x, a2y = columns
    filter_2d = view[layout.FILTER_2D]
    det = det_bare + filter_2d * (sxx + syy + filter_2d)
    wide, fyy = det, syy + filter_2d
    if blur.size > 0:
        extra = gather8_at(blur, rows, 1, 0)
        trace = sxx + syy + (filter_2d + filter_2d)
        wide, fyy = det + extra * (trace + extra), fyy + extra

    # The inverse of the footprint's covariance is L L^T with L^T = [[l11, l21], [0, l22]].
    l11, l22 = sqrt8(fyy / wide), ONE / sqrt8(fyy)
    l21 = -sxy / sqrt8(fyy * wide)
    # Everything is in whitened coordinates, L^T (dx, dy), in which moments and axes are of order 1. Computing the
    # gradient with respect to the covariance instead would lose all digits for a long needle.
    n_x, n_y = l11 * q_x + l21 * q_y, l22 * q_y
    g_mx, g_my = l11 * n_x, l21 * n_x + l22 * n_y
    if d_radius.size > 0:
        # dL/d(mean) is L L^T (Q_X, Q_Y) for each lens point; the sums hold its products with the points.
        m_xx, m_xy, m_yy = l11 * l11, l11 * l21, l21 * l21 + l22 * l22
        along_x, across, along_y = sum_t, sum_tx, sum_ty  # S_POINT_XX, S_POINT_XY, S_POINT_YY
        scatter8_at(d_radius, rows, 1, 0, m_xx * along_x + m_xy * across + m_yy * along_y)
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

    opacity = ONE / (ONE + exp8(-gather8_at(opacity_logits, rows, 1, 0)))
    scatter8_at(d_logits, rows, 1, 0, q0 * (ONE - opacity))
    fades = view[layout.FADES] > ZERO
    if fades or blur.size > 0:
        to_bare, to_trace = splat8(ZERO), splat8(ZERO)
        if fades:
            padded = det + layout.MIN_DETERMINANT
            ratio = det_bare / padded
            to_ratio = q0 / (ratio + layout.MIN_DETERMINANT)
            to_bare = to_ratio * (ONE - ratio) / padded
            to_trace = -to_ratio * ratio / padded * filter_2d
        if blur.size > 0:
            # The gradient of the opacity's factor sqrt(det / wide), by the determinant and trace without blur. The
            # differences that make this term vanish without blur are computed analytically.
            by_both = q0 * extra / (det * wide)
            to_bare += by_both * (trace + extra)
            to_trace += by_both * (filter_2d * (filter_2d + extra) - det_bare)
            # The part that comes from the footprint is the trace of dL/d(covariance).
            widened = n_xx * (l11 * l11 + l21 * l21) + (n_xy + n_xy) * (l21 * l22) + n_yy * (l22 * l22)
            scatter8_at(d_blur, rows, 1, 0, HALF * (widened - q0 * (trace + extra + extra) / wide))
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
    g_x, g_y = splat8(ZERO), splat8(ZERO)

    if geometry > 0:
        (w0, w1, w2), (k0, k1, k2), (b0, b1, b2), (hx, hy, hz), along, length = plane8(axes, (e0, e1, e2), cu, cv)
        plane = along > layout.EDGE_ON * length
        ia = select8(plane, ONE / along, ZERO)
        ig = ONE / (cu * cu + (cv * cv + ONE))
        distance = sqrt8(dot3(x, y, z, x, y, z))
        g_tx, g_ty = -sum_tx, -sum_ty
        slope_x = select8(plane, (hx * ia - cu * ig) / fx, ZERO)
        slope_y = select8(plane, (hy * ia - cv * ig) / fy, ZERO)
        g_mx += distance * slope_x * sum_t
        g_my += distance * slope_y * sum_t
        g_distance = (sum_t + g_tx * slope_x + g_ty * slope_y) / distance
        g_x += g_distance * x
        g_y += g_distance * y
        g_z += g_distance * z
        # m = h / (r . h), slope = (m - r / |r|**2) / focal length, in x and y; r = (cu, cv, 1).
        p_x, p_y = select8(plane, g_tx * distance / fx, ZERO), select8(plane, g_ty * distance / fy, ZERO)
        pull = TWO * (p_x * cu + p_y * cv) * ig * ig
        g_u += pull * cu - p_x * ig
        g_v += pull * cv - p_y * ig
        h_x, h_y = p_x * ia, p_y * ia
        g_along = -(h_x * hx + h_y * hy) * ia
        g_u += g_along * hx
        g_v += g_along * hy
        h_x, h_y, h_z = h_x + g_along * cu, h_y + g_along * cv, g_along
        if geometry > 1:
            il = select8(plane, ONE / length, ZERO)
            nx, ny, nz = hx * il, hy * il, hz * il
            radial = dot3(nx, ny, nz, to_nx, to_ny, to_nz)
            h_x += (nx * radial - to_nx) * il
            h_y += (ny * radial - to_ny) * il
            h_z += (nz * radial - to_nz) * il
        # h = sum of w_i k_i m_i with k_i = m_i . r.
        t0, t1, t2 = (
            dot3(h_x, h_y, h_z, m0x, m0y, m0z),
            dot3(h_x, h_y, h_z, m1x, m1y, m1z),
            dot3(h_x, h_y, h_z, m2x, m2y, m2z),
        )
        g_e0 += -TWO * w0 * k0 * t0
        g_e1 += -TWO * w1 * k1 * t1
        g_e2 += -TWO * w2 * k2 * t2
        c0, c1, c2 = w0 * t0, w1 * t1, w2 * t2
        g0x, g0y, g0z = g0x + b0 * h_x + c0 * cu, g0y + b0 * h_y + c0 * cv, g0z + b0 * h_z + c0
        g1x, g1y, g1z = g1x + b1 * h_x + c1 * cu, g1y + b1 * h_y + c1 * cv, g1z + b1 * h_z + c1
        g2x, g2y, g2z = g2x + b2 * h_x + c2 * cu, g2y + b2 * h_y + c2 * cv, g2z + b2 * h_z + c2
        g_u += dot3(c0, c1, c2, m0x, m1x, m2x)
        g_v += dot3(c0, c1, c2, m0y, m1y, m2y)

    store8(grad_2d, 0, g_mx)
    store8(grad_2d, LANES, g_my)
    g_u = select8(u_free, g_u, ZERO) + g_mx * fx
    g_v = select8(v_free, g_v, ZERO) + g_my * fy
    g_x += g_u * iz
    g_y += g_v * iz
    g_z += -(g_u * u + g_v * v) * iz

    # Log scales: through the filtered scale, and through the opacity's factor s / e.
    r0, r1, r2 = ratio8(s0, e0), ratio8(s1, e1), ratio8(s2, e2)
    r0, r1, r2 = r0 * r0, r1 * r1, r2 * r2
    scatter8_at(d_scales, rows, 3, 0, g_e0 * r0 + q0 * (ONE - r0))
    scatter8_at(d_scales, rows, 3, 1, g_e1 * r1 + q0 * (ONE - r1))
    scatter8_at(d_scales, rows, 3, 2, g_e2 * r2 + q0 * (ONE - r2))

    r00, r01, r02 = view[layout.ROTATION], view[layout.ROTATION + 1], view[layout.ROTATION + 2]
    r10, r11, r12 = view[layout.ROTATION + 3], view[layout.ROTATION + 4], view[layout.ROTATION + 5]
    r20, r21, r22 = view[layout.ROTATION + 6], view[layout.ROTATION + 7], view[layout.ROTATION + 8]
    g_rotation = (
        r00 * g0x + (r10 * g0y + r20 * g0z), r01 * g0x + (r11 * g0y + r21 * g0z), r02 * g0x + (r12 * g0y + r22 * g0z),
        r00 * g1x + (r10 * g1y + r20 * g1z), r01 * g1x + (r11 * g1y + r21 * g1z), r02 * g1x + (r12 * g1y + r22 * g1z),
        r00 * g2x + (r10 * g2y + r20 * g2z), r01 * g2x + (r11 * g2y + r21 * g2z), r02 * g2x + (r12 * g2y + r22 * g2z),
    )  # fmt: skip
    g_w, g_i, g_j, g_k = quaternion_backward8(w, qx, qy, qz, inverse_norm, g_rotation)
    scatter8_at(d_quaternions, rows, 4, 0, g_w)
    scatter8_at(d_quaternions, rows, 4, 1, g_i)
    scatter8_at(d_quaternions, rows, 4, 2, g_j)
    scatter8_at(d_quaternions, rows, 4, 3, g_k)

    # A colour channel that was clamped at 0 passes no gradient on.
    step = layout.RECORD
    red = select8(gather8_at(records, rows, step, layout.RED) > ZERO, sum_red, ZERO)
    green = select8(gather8_at(records, rows, step, layout.GREEN) > ZERO, sum_green, ZERO)
    blue = select8(gather8_at(records, rows, step, layout.BLUE) > ZERO, sum_blue, ZERO)
    eye = layout.CENTRE
    dx, dy, dz = px - view[eye], py - view[eye + 1], pz - view[eye + 2]
    dx, dy, dz = color_backward8(
        sh_rest, rest, degree, rows, dx, dy, dz, red, green, blue, d_dc, d_rest, basis, pulls, coefficients
    )
    scatter8_at(d_means, rows, 3, 0, r00 * g_x + (r10 * g_y + r20 * g_z) + dx)
    scatter8_at(d_means, rows, 3, 1, r01 * g_x + (r11 * g_y + r21 * g_z) + dy)
    scatter8_at(d_means, rows, 3, 2, r02 * g_x + (r12 * g_y + r22 * g_z) + dz)
