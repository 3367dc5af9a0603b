"""From raw parameters to screen-space records, eight Gaussians at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, any8, bits8, select8, splat8
from dofbench.runtime.simd_functions import exp8, floor8, log2_8, max8, min8, sqrt8
from dofbench.runtime.simd_memory import gather8, load8, scatter8, store8

from . import cpu_layout as layout
from .cpu_bin import count_tiles
from .cpu_footprint import ONE, ZERO, axes8, dot3, footprint8, plane8, ratio8, sizes8, to_camera8, unit_quaternion8
from .cpu_layout import CHUNKS, MIN_ALPHA, tails_of
from .cpu_sh import TERMS, color8

HALF = np.float32(0.5)


@internal(error_model="numpy")
def project_block(inputs, rest, degree, geometry, view, i, outputs, out, basis):
    """Project Gaussians i … i + 7 of the inputs into places out … out + 7; returns the lanes gone non-finite."""
    means, log_scales, quaternions, opacity_logits, sh_dc, sh_rest, filter_3d, blur, margin = inputs
    records, depths, radii, visible, _ = outputs
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
    drawn = det
    if view[layout.FADES] > ZERO:
        drawn = det_bare
        opacity = opacity * sqrt8(det_bare / (det + layout.MIN_DETERMINANT) + layout.MIN_DETERMINANT)
    # A logit of +inf gives opacity 1, and a scale of 0 gives opacity 0; both are finite and accepted.
    finite = finite & ((~in_front) | ((det - det) + (opacity - opacity) == ZERO))

    seen = in_front & finite & (drawn > layout.MIN_DETERMINANT) & (opacity > MIN_ALPHA)
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
        tx, ty = distance * (hx * inverse_along - cu * ig) / fx, distance * (hy * inverse_along - cv * ig) / fy
        scatter8(records, base + layout.TX, layout.RECORD, select8(edge_on, ZERO, tx))
        scatter8(records, base + layout.TY, layout.RECORD, select8(edge_on, ZERO, ty))
        if geometry > 1:
            unit = select8(edge_on, ZERO, -ONE / select8(edge_on, ONE, length))
            scatter8(records, base + layout.NX, layout.RECORD, hx * unit)
            scatter8(records, base + layout.NY, layout.RECORD, hy * unit)
            scatter8(records, base + layout.NZ, layout.RECORD, hz * unit)
    return bits8(~finite)


@internal(error_model="numpy")
def project_blocks(inputs, rest, tails, degree, geometry, view, first, stop, outputs):
    """Project the blocks first … stop - 1; returns the index of a Gaussian that is not finite, or -1."""
    n, margin = inputs[3].size, inputs[8]
    records, _, _, visible, counts = outputs
    bad = -1
    basis = np.empty(TERMS * LANES, np.float32)
    for block in range(first, stop):
        i = block * LANES
        # One call with selected arguments, since a second call would compile a second copy.
        place, eight = (i, inputs) if i + LANES <= n else (0, tails)
        lost = project_block(eight, rest, degree, geometry, view, place, outputs, i, basis)
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
@njit(parallel=PRANGE, error_model="numpy")
def project(inputs, rest, degree, geometry, view, outputs):
    """Fill outputs: records, depths, radii, visible and counts (tiles met) of every Gaussian.

    inputs: the six parameters, filter_3d, blur and margin, flat; the last three empty where there is none. rest: number
    of SH coefficients beyond the first. margin: pixels by which a Gaussian may be moved before it is drawn, so that
    those just outside the image count as visible; counts is then 1 for each visible one, since the tiles depend on the
    move. geometry: 0 none, 1 depth, 2 full. The outputs have room for N rounded up to a multiple of eight. Returns the
    index of a Gaussian that is not finite, or -1.
    """
    blocks = (inputs[3].size + LANES - 1) // LANES
    chunks = min(blocks, CHUNKS)
    bad = np.full(max(chunks, 1), -1)
    tails = tails_of(inputs, inputs[3].size)
    for chunk in prange(chunks):
        first, stop = chunk * blocks // chunks, (chunk + 1) * blocks // chunks
        bad[chunk] = project_blocks(inputs, rest, tails, degree, geometry, view, first, stop, outputs)
    return bad.max()
