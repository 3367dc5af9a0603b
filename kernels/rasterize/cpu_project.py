"""From raw parameters to screen-space records, eight Gaussians at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.compute.kernel_cache import cached
from dofbench.compute.simd import (
    LANES,
    abs8,
    any8,
    bits8,
    exp8,
    floor8,
    gather8,
    load8,
    log2_8,
    max8,
    min8,
    scatter8,
    select8,
    splat8,
    sqrt8,
    store8,
)

from . import cpu_layout as layout
from .cpu_bin import count_tiles
from .cpu_sh import TERMS, color8

ONE = np.float32(1.0)
HALF = np.float32(0.5)
ZERO = np.float32(0.0)
# Number of parts into which the Gaussians are divided for threads: enough for many threads, with negligible overhead.
CHUNKS = 64
MIN_ALPHA = np.float32(layout.MIN_ALPHA)


@njit(forceinline=True)
def dot3(ax, ay, az, bx, by, bz):
    """Scalar product of two triples."""
    return ax * bx + (ay * by + az * bz)


@njit(forceinline=True)
def to_camera8(view, x, y, z):
    """World position to camera position."""
    r = layout.ROTATION
    t = layout.TRANSLATION
    return (
        view[r] * x + (view[r + 1] * y + (view[r + 2] * z + view[t])),
        view[r + 3] * x + (view[r + 4] * y + (view[r + 5] * z + view[t + 1])),
        view[r + 6] * x + (view[r + 7] * y + (view[r + 8] * z + view[t + 2])),
    )


@njit(forceinline=True)
def unit_quaternion8(quaternions, i):
    """The normalised quaternion (identity for a zero one) and 1 / norm (0 for a zero one)."""
    w, x, y, z = (
        gather8(quaternions, 4 * i, 4),
        gather8(quaternions, 4 * i + 1, 4),
        gather8(quaternions, 4 * i + 2, 4),
        gather8(quaternions, 4 * i + 3, 4),
    )
    # Dividing by the largest component first keeps the squares from overflowing or underflowing.
    largest = max8(max8(abs8(w), abs8(x)), max8(abs8(y), abs8(z)))
    zero = largest == ZERO
    scale = ONE / select8(zero, ONE, largest)
    w, x, y, z = w * scale, x * scale, y * scale, z * scale
    inverse = ONE / sqrt8(select8(zero, ONE, w * w + x * x + (y * y + z * z)))
    w = select8(zero, ONE, w * inverse)
    return w, x * inverse, y * inverse, z * inverse, select8(zero, ZERO, inverse * scale)


@njit(forceinline=True)
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
        r00 * c0x + (r01 * c0y + r02 * c0z),
        r10 * c0x + (r11 * c0y + r12 * c0z),
        r20 * c0x + (r21 * c0y + r22 * c0z),
        r00 * c1x + (r01 * c1y + r02 * c1z),
        r10 * c1x + (r11 * c1y + r12 * c1z),
        r20 * c1x + (r21 * c1y + r22 * c1z),
        r00 * c2x + (r01 * c2y + r02 * c2z),
        r10 * c2x + (r11 * c2y + r12 * c2z),
        r20 * c2x + (r21 * c2y + r22 * c2z),
    )


@njit(forceinline=True)
def sizes8(log_scales, filter_3d, i):
    """Per axis the scale s, and the filtered scale e = sqrt(s**2 + f**2): (s0, s1, s2, e0, e1, e2)."""
    s0 = exp8(gather8(log_scales, 3 * i, 3))
    s1 = exp8(gather8(log_scales, 3 * i + 1, 3))
    s2 = exp8(gather8(log_scales, 3 * i + 2, 3))
    if filter_3d.size == 0:
        return s0, s1, s2, s0, s1, s2
    f = load8(filter_3d, i)
    f2 = f * f
    # The square of a scale below 1e-19 underflows in float32; the filtered scale must not become smaller than the
    # scale.
    return s0, s1, s2, max8(sqrt8(s0 * s0 + f2), s0), max8(sqrt8(s1 * s1 + f2), s1), max8(sqrt8(s2 * s2 + f2), s2)


@njit(forceinline=True)
def ratio8(a, b):
    """a / b, with 0 / 0 = 1; a and b >= a are a scale before and after the 3D filter."""
    return select8(a == b, ONE, a / b)


@njit(forceinline=True)
def minor8(ax, ay, bx, by):
    """The determinant of a two by two block, ax by - ay bx."""
    return ax * by - ay * bx


@njit(forceinline=True)
def weights8(e0, e1, e2):
    """(e_min / e_i)**2: the inverse covariance up to a factor that the plane doesn't depend on."""
    least = min8(e0, min8(e1, e2))
    w0, w1, w2 = ratio8(least, e0), ratio8(least, e1), ratio8(least, e2)
    return w0 * w0, w1 * w1, w2 * w2


@njit(forceinline=True)
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


@njit(forceinline=True)
def plane8(axes, filtered, cu, cv):
    """The plane of largest density along each ray (RaDe-GS, current version), given by its normal h up to a factor.

    Returns the weights w of the axes m, k_i = m_i . r with the ray r = (cu, cv, 1), w_i k_i, h = sum of w_i k_i m_i,
    h . r and the length of h.
    """
    m0x, m0y, m0z, m1x, m1y, m1z, m2x, m2y, m2z = axes
    e0, e1, e2 = filtered
    w0, w1, w2 = weights8(e0, e1, e2)
    k0, k1, k2 = m0x * cu + (m0y * cv + m0z), m1x * cu + (m1y * cv + m1z), m2x * cu + (m2y * cv + m2z)
    b0, b1, b2 = w0 * k0, w1 * k1, w2 * k2
    hx, hy, hz = dot3(b0, b1, b2, m0x, m1x, m2x), dot3(b0, b1, b2, m0y, m1y, m2y), dot3(b0, b1, b2, m0z, m1z, m2z)
    along = dot3(b0, b1, b2, k0, k1, k2)
    return (w0, w1, w2), (k0, k1, k2), (b0, b1, b2), (hx, hy, hz), along, sqrt8(dot3(hx, hy, hz, hx, hy, hz))


@njit(error_model="numpy")
def project_block(
    means,
    log_scales,
    quaternions,
    opacity_logits,
    sh_dc,
    sh_rest,
    rest,
    filter_3d,
    blur,
    margin,
    degree,
    geometry,
    view,
    i,
    records,
    depths,
    radii,
    visible,
    out,
    basis,
):
    """Project Gaussians i … i + 7 of the inputs into places out … out + 7; returns the lanes gone non-finite."""
    px, py, pz = gather8(means, 3 * i, 3), gather8(means, 3 * i + 1, 3), gather8(means, 3 * i + 2, 3)
    x, y, z = to_camera8(view, px, py, pz)
    fx, fy = view[layout.FX], view[layout.FY]
    in_front = z > view[layout.NEAR]
    # x - x is 0 for a finite x and NaN otherwise, so the sum is 0 exactly if every term is finite.
    finite = (x - x) + (y - y) + (z - z) == ZERO
    store8(depths, out, z)
    if not any8(in_front):
        for lane in range(LANES):
            visible[out + lane] = False
            radii[out + lane] = ZERO
        return bits8(~finite)

    safe_z = select8(in_front, z, ONE)
    iz = ONE / safe_z
    u, v = x * iz, y * iz
    cu = min8(max8(u, view[layout.U_LOW]), view[layout.U_HIGH])
    cv = min8(max8(v, view[layout.V_LOW]), view[layout.V_HIGH])

    w, qx, qy, qz, _ = unit_quaternion8(quaternions, i)
    axes = axes8(view, w, qx, qy, qz)
    s0, s1, s2, e0, e1, e2 = sizes8(log_scales, filter_3d, i)
    _, _, (sxx, sxy, syy), _, det_bare = footprint8(view, axes, (e0, e1, e2), iz, cu, cv)
    filter_2d = view[layout.FILTER_2D]
    det = det_bare + filter_2d * (sxx + syy + filter_2d)
    fxx, fyy = sxx + filter_2d, syy + filter_2d

    opacity = ONE / (ONE + exp8(-load8(opacity_logits, i)))
    opacity = opacity * (ratio8(s0, e0) * ratio8(s1, e1) * ratio8(s2, e2))
    if filter_2d > ZERO:
        opacity = opacity * sqrt8(det_bare / (det + layout.MIN_DETERMINANT) + layout.MIN_DETERMINANT)
    # A logit of +inf gives opacity 1, and a scale of 0 gives opacity 0; both are finite and accepted.
    finite = finite & ((~in_front) | ((det - det) + (opacity - opacity) == ZERO))

    seen = in_front & finite & (det_bare > layout.MIN_DETERMINANT) & (opacity > MIN_ALPHA)
    det = select8(seen, det, ONE)
    fxx, fyy = select8(seen, fxx, ONE), select8(seen, fyy, ONE)
    sxy = select8(seen, sxy, ZERO)
    log2_opacity, limit = log2_8(select8(seen, opacity, ONE)), splat8(layout.LOG2_MIN_ALPHA)
    # `limit` lies at this many standard deviations, in base 2.
    reach = sqrt8(log2_opacity - limit)
    if blur.size > 0:
        extra = load8(blur, i)
        wide = det + extra * (fxx + fyy + extra)
        finite = finite & ((~in_front) | (wide - wide == ZERO))
        seen = seen & finite
        # Opacity and limit are reduced by the same factor, so the ellipse in which the Gaussian is drawn holds the same
        # share of its integral.
        loss = HALF * log2_8(select8(seen, det / wide, ONE))
        log2_opacity, limit = log2_opacity + loss, limit + loss
        det, fxx, fyy = select8(seen, wide, ONE), fxx + extra, fyy + extra
    l11 = layout.EXPONENT_SCALE * sqrt8(fyy / det)
    l21 = layout.EXPONENT_SCALE * (-sxy / sqrt8(fyy * det))
    l22 = layout.EXPONENT_SCALE / sqrt8(fyy)

    mx, my = fx * u + view[layout.CX], fy * v + view[layout.CY]
    half_x, half_y = reach / layout.EXPONENT_SCALE * sqrt8(fxx), reach / layout.EXPONENT_SCALE * sqrt8(fyy)
    if margin.size > 0:
        around = load8(margin, i)
        finite = finite & ((~in_front) | (around - around == ZERO))
        seen = seen & finite
        half_x, half_y = half_x + around, half_y + around
    left, top = max8(-floor8(half_x + HALF - mx), ZERO), max8(-floor8(half_y + HALF - my), ZERO)
    right = min8(floor8(mx + half_x - HALF), view[layout.WIDTH] - ONE)
    bottom = min8(floor8(my + half_y - HALF), view[layout.HEIGHT] - ONE)
    seen = seen & (left <= right) & (top <= bottom)

    mean = HALF * (fxx + fyy)
    spread = HALF * (fxx - fyy)
    major = mean + sqrt8(spread * spread + sxy * sxy)
    store8(radii, out, select8(seen, np.float32(3.0) * sqrt8(major), ZERO))
    bits = bits8(seen)
    for lane in range(LANES):
        visible[out + lane] = (bits >> lane) & 1 != 0
    if bits == 0:
        return bits8(~finite)

    base = out * layout.RECORD
    scatter8(records, base + layout.MX, layout.RECORD, mx)
    scatter8(records, base + layout.MY, layout.RECORD, my)
    scatter8(records, base + layout.L11, layout.RECORD, l11)
    scatter8(records, base + layout.L21, layout.RECORD, l21)
    scatter8(records, base + layout.L22, layout.RECORD, l22)
    scatter8(records, base + layout.LOG2_OPACITY, layout.RECORD, log2_opacity)
    scatter8(records, base + layout.LIMIT, layout.RECORD, limit)

    eye = layout.CENTRE
    red, green, blue = color8(
        sh_dc, sh_rest, rest, degree, i, px - view[eye], py - view[eye + 1], pz - view[eye + 2], basis
    )
    finite = finite & ((~seen) | ((red - red) + (green - green) + (blue - blue) == ZERO))
    scatter8(records, base + layout.RED, layout.RECORD, max8(red, ZERO))
    scatter8(records, base + layout.GREEN, layout.RECORD, max8(green, ZERO))
    scatter8(records, base + layout.BLUE, layout.RECORD, max8(blue, ZERO))

    if geometry > 0:
        _, _, _, (hx, hy, hz), along, length = plane8(axes, (e0, e1, e2), cu, cv)
        edge_on = along <= layout.EDGE_ON * length
        inverse_along = ONE / select8(edge_on, ONE, along)
        ig = ONE / (cu * cu + (cv * cv + ONE))
        distance = sqrt8(dot3(x, y, z, x, y, z))
        scatter8(records, base + layout.T0, layout.RECORD, distance)
        scatter8(
            records,
            base + layout.TX,
            layout.RECORD,
            select8(edge_on, ZERO, distance * (hx * inverse_along - cu * ig) / fx),
        )
        scatter8(
            records,
            base + layout.TY,
            layout.RECORD,
            select8(edge_on, ZERO, distance * (hy * inverse_along - cv * ig) / fy),
        )
        if geometry > 1:
            unit = select8(edge_on, ZERO, -ONE / select8(edge_on, ONE, length))
            scatter8(records, base + layout.NX, layout.RECORD, hx * unit)
            scatter8(records, base + layout.NY, layout.RECORD, hy * unit)
            scatter8(records, base + layout.NZ, layout.RECORD, hz * unit)
    return bits8(~finite)


@njit(error_model="numpy")
def tail_of(array, n):
    """The rows of a flat array of n rows after the last full block of eight, padded with zeros to eight."""
    width = array.size // n if n > 0 else 0
    padded = np.zeros(LANES * width, np.float32)
    start = n // LANES * LANES * width
    for k in range(start, n * width):
        padded[k - start] = array[k]
    return padded


@njit(error_model="numpy")
def tails_of(means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest, filter_3d, blur, margin):
    """The last, incomplete block of every input."""
    n = opacity_logits.size
    return (
        tail_of(means, n),
        tail_of(log_scales, n),
        tail_of(quaternions, n),
        tail_of(opacity_logits, n),
        tail_of(sh_dc, n),
        tail_of(sh_rest, n),
        tail_of(filter_3d, n),
        tail_of(blur, n),
        tail_of(margin, n),
    )


@njit(error_model="numpy")
def project_blocks(
    means,
    log_scales,
    quaternions,
    opacity_logits,
    sh_dc,
    sh_rest,
    rest,
    filter_3d,
    blur,
    margin,
    tails,
    degree,
    geometry,
    view,
    first,
    stop,
    records,
    depths,
    radii,
    visible,
    counts,
):
    """Project the blocks first … stop - 1; returns the index of a Gaussian that is not finite, or -1."""
    n = opacity_logits.size
    bad = -1
    basis = np.empty(TERMS * LANES, np.float32)
    for block in range(first, stop):
        i = block * LANES
        # One call with selected arguments, since a second call would compile a second copy.
        if i + LANES <= n:
            place, a, b, c, d, e, f, g, h, m = (
                i,
                means,
                log_scales,
                quaternions,
                opacity_logits,
                sh_dc,
                sh_rest,
                filter_3d,
                blur,
                margin,
            )
        else:
            place, (a, b, c, d, e, f, g, h, m) = 0, tails
        lost = project_block(
            a, b, c, d, e, f, rest, g, h, m, degree, geometry, view, place, records, depths, radii, visible, i, basis
        )
        for lane in range(min(LANES, n - i)):
            if (lost >> lane) & 1:
                bad = i + lane
            met = 0
            if visible[i + lane]:
                met = count_tiles(records, i + lane, view) if margin.size == 0 else 1
            counts[i + lane] = met
        for k in range(n, i + LANES):
            visible[k] = False
            counts[k] = 0
    return bad


@cached
@njit(parallel=True, error_model="numpy")
def project(
    means,
    log_scales,
    quaternions,
    opacity_logits,
    sh_dc,
    sh_rest,
    rest,
    filter_3d,
    blur,
    margin,
    degree,
    geometry,
    view,
    records,
    depths,
    radii,
    visible,
    counts,
):
    """Fill records, depths, radii, visible and counts (tiles met) of every Gaussian.

    Inputs are flat, filter_3d, blur and margin empty where there is none; `rest` is the number of SH coefficients
    beyond the first. margin: pixels by which a Gaussian may be moved before it is drawn, so that those just outside the
    image count as visible; counts is then 1 for each visible one, since the tiles depend on the move. geometry: 0 none,
    1 depth, 2 full. The outputs have room for N rounded up to a multiple of eight. Returns the index of a Gaussian that
    is not finite, or -1.
    """
    blocks = (opacity_logits.size + LANES - 1) // LANES
    chunks = min(blocks, CHUNKS)
    bad = np.full(max(chunks, 1), -1)
    tails = tails_of(means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest, filter_3d, blur, margin)
    for chunk in prange(chunks):
        bad[chunk] = project_blocks(
            means,
            log_scales,
            quaternions,
            opacity_logits,
            sh_dc,
            sh_rest,
            rest,
            filter_3d,
            blur,
            margin,
            tails,
            degree,
            geometry,
            view,
            chunk * blocks // chunks,
            (chunk + 1) * blocks // chunks,
            records,
            depths,
            radii,
            visible,
            counts,
        )
    return bad.max()
