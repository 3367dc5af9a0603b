"""Triton kernel of projection: from raw parameters to screen-space records, one thread for each Gaussian."""

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
    finite,
    load3,
    normal_of,
    ratio,
    sizes,
    store3,
    to_camera,
    unit_quaternion,
    weights_of,
)


@triton.jit(do_not_specialize=["n"])
def project(
    means, log_scales, quaternions, opacity_logits, filter_3d, blur, radius, view, records, depths, radii, n,
    GEOMETRY: tl.constexpr, FADES: tl.constexpr, FILTERED: tl.constexpr, BLURRED: tl.constexpr, MOVED: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Fill the records but for colours, depths, and radii: three standard deviations, 0 for a Gaussian that can't be
    seen wherever its mean lies in the image, NaN for one that isn't finite."""
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = i < n
    px, py, pz = load3(means, 3 * i, inside)
    x, y, z = to_camera(view, px, py, pz)
    in_front = inside & (z > tl.load(view + layout.NEAR))
    good = finite(x) & finite(y) & finite(z)
    iz = 1.0 / tl.where(in_front, z, 1.0)
    u, v = x * iz, y * iz
    cu = tl.minimum(tl.maximum(u, tl.load(view + layout.U_LOW)), tl.load(view + layout.U_HIGH))
    cv = tl.minimum(tl.maximum(v, tl.load(view + layout.V_LOW)), tl.load(view + layout.V_HIGH))

    qw, qx, qy, qz, _ = unit_quaternion(quaternions, i, inside)
    m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z = axes_of(view, qw, qx, qy, qz)
    s0, s1, s2, e0, e1, e2 = sizes(log_scales, filter_3d, i, inside, FILTERED)
    k0x, k1x, k2x, k0y, k1y, k2y = factors_of(view, iz, e0, e1, e2)
    a0x, a0y, a1x, a1y, a2x, a2y = columns_of(
        k0x, k1x, k2x, k0y, k1y, k2y, m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z, cu, cv
    )
    sxx, sxy, syy, _, _, _, bare = covariance_of(a0x, a0y, a1x, a1y, a2x, a2y)
    filter_2d = tl.load(view + layout.FILTER_2D)
    det = bare + filter_2d * (sxx + syy + filter_2d)
    fxx, fyy = sxx + filter_2d, syy + filter_2d

    opacity = tl.sigmoid(tl.load(opacity_logits + i, mask=inside, other=0.0))
    opacity = opacity * (ratio(s0, e0) * ratio(s1, e1) * ratio(s2, e2))
    drawn = det
    if FADES:
        drawn = bare
        opacity = opacity * tl.sqrt(bare / (det + layout.MIN_DETERMINANT) + layout.MIN_DETERMINANT)
    # A logit of +inf gives opacity 1, and a scale of 0 gives opacity 0; both are finite and accepted.
    good = good & ((in_front == 0) | (finite(det) & finite(opacity)))
    seen = in_front & good & (drawn > layout.MIN_DETERMINANT) & (opacity > layout.MIN_ALPHA)
    det = tl.where(seen, det, 1.0)
    fxx, fyy, sxy = tl.where(seen, fxx, 1.0), tl.where(seen, fyy, 1.0), tl.where(seen, sxy, 0.0)
    log2_opacity = tl.log2(tl.where(seen, opacity, 1.0))
    limit = tl.full((BLOCK,), layout.LOG2_MIN_ALPHA, tl.float32)
    if BLURRED:
        extra = tl.load(blur + i, mask=inside, other=0.0)
        wide = det + extra * (fxx + fyy + extra)
        good = good & ((in_front == 0) | finite(wide)) & ((extra < 0.0) == 0)
        seen = seen & good
        # Opacity and limit are reduced by the same factor, so the ellipse in which the Gaussian is drawn holds the same
        # share of its integral.
        loss = 0.5 * tl.log2(tl.where(seen, det / wide, 1.0))
        log2_opacity, limit = log2_opacity + loss, limit + loss
        det, fxx, fyy = tl.where(seen, wide, 1.0), fxx + extra, fyy + extra
    if MOVED:
        good = good & ((in_front == 0) | finite(tl.load(radius + i, mask=inside, other=0.0)))
        seen = seen & good

    mean, spread = 0.5 * (fxx + fyy), 0.5 * (fxx - fyy)
    longest = 3.0 * tl.sqrt(mean + tl.sqrt(spread * spread + sxy * sxy))
    tl.store(depths + i, z, mask=inside)
    tl.store(radii + i, tl.where(good, tl.where(seen, longest, 0.0), float("nan")), mask=inside)
    base = records + i * layout.RECORD
    tl.store(base + layout.MX, tl.load(view + layout.FX) * u + tl.load(view + layout.CX), mask=seen)
    tl.store(base + layout.MY, tl.load(view + layout.FY) * v + tl.load(view + layout.CY), mask=seen)
    # The inverse of the footprint's covariance is L L^T with L^T = [[l11, l21], [0, l22]].
    store3(
        base, layout.L11, tl.sqrt(fyy / det) * layout.EXPONENT_SCALE, -sxy / tl.sqrt(fyy * det) * layout.EXPONENT_SCALE,
        1.0 / tl.sqrt(fyy) * layout.EXPONENT_SCALE, seen,
    )  # fmt: skip
    tl.store(base + layout.LOG2_OPACITY, log2_opacity, mask=seen)
    tl.store(base + layout.LIMIT, limit, mask=seen)

    if GEOMETRY > 0:
        w0, w1, w2 = weights_of(e0, e1, e2)
        k0, k1, k2 = m0x * cu + (m0y * cv + m0z), m1x * cu + (m1y * cv + m1z), m2x * cu + (m2y * cv + m2z)
        b0, b1, b2 = w0 * k0, w1 * k1, w2 * k2
        hx, hy, hz, along, length = normal_of(m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z, b0, b1, b2, k0, k1, k2)
        edge_on = along <= length * layout.EDGE_ON
        inverse = 1.0 / tl.where(edge_on, 1.0, along)
        ig = 1.0 / (cu * cu + (cv * cv + 1.0))
        distance = tl.sqrt(dot3(x, y, z, x, y, z))
        tx = distance * (hx * inverse - cu * ig) / tl.load(view + layout.FX)
        ty = distance * (hy * inverse - cv * ig) / tl.load(view + layout.FY)
        store3(base, layout.T0, distance, tl.where(edge_on, 0.0, tx), tl.where(edge_on, 0.0, ty), seen)
        if GEOMETRY > 1:
            unit = tl.where(edge_on, 0.0, -1.0 / tl.where(edge_on, 1.0, length))
            store3(base, layout.NX, hx * unit, hy * unit, hz * unit, seen)
