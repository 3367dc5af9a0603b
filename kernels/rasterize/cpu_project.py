"""From raw parameters to screen-space records, eight Gaussians at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, any8, bits8, select8, splat8
from dofbench.runtime.simd_functions import exp8, floor8, log2_8, max8, min8, sqrt8
from dofbench.runtime.simd_memory import load8, store8
from dofbench.runtime.simd_rows import gather8_at, load_fours8, load_threes8, scatter8_at, store_rows8

from . import cpu_layout as layout
from .cpu_bin import count_tiles
from .cpu_footprint import ONE, ZERO, axes8, dot3, footprint8, plane8, ratio8, sizes8, to_camera8, unit_quaternion8
from .cpu_layout import CHUNKS, MIN_ALPHA, tails_of
from .cpu_sh import TERMS, color8, prefetch_terms

HALF = np.float32(0.5)


@internal(error_model="numpy")
def project_block(inputs, geometry, view, i, outputs, out):
    """Project Gaussians i … i + 7 of the inputs into places out … out + 7, all but their colours; returns the lanes
    gone non-finite."""
    means, log_scales, quaternions, opacity_logits, _, _, filter_3d, blur, margin = inputs
    records, depths, radii, visible, _ = outputs
    px, py, pz = load_threes8(means, 3 * i)
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

    w, qx, qy, qz = load_fours8(quaternions, 4 * i)
    w, qx, qy, qz, _ = unit_quaternion8(w, qx, qy, qz)
    axes = axes8(view, w, qx, qy, qz)
    filtered = filter_3d.size > 0
    size = load8(filter_3d, i) if filtered else splat8(ZERO)
    log0, log1, log2 = load_threes8(log_scales, 3 * i)
    s0, s1, s2, e0, e1, e2 = sizes8(log0, log1, log2, filtered, size)
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

    base, none = out * layout.RECORD, splat8(ZERO)
    t0, tx, ty, nx, ny, nz = none, none, none, none, none, none
    if geometry > 0:
        _, _, _, (hx, hy, hz), along, length = plane8(axes, (e0, e1, e2), cu, cv)
        edge_on = along <= layout.EDGE_ON * length
        inverse_along = ONE / select8(edge_on, ONE, along)
        ig = ONE / (cu * cu + (cv * cv + ONE))
        t0 = sqrt8(dot3(x, y, z, x, y, z))
        tx, ty = t0 * (hx * inverse_along - cu * ig) / fx, t0 * (hy * inverse_along - cv * ig) / fy
        tx, ty = select8(edge_on, ZERO, tx), select8(edge_on, ZERO, ty)
        if geometry > 1:
            unit = select8(edge_on, ZERO, -ONE / select8(edge_on, ONE, length))
            nx, ny, nz = hx * unit, hy * unit, hz * unit
    # In the order of the record; colours follow for those that are visible.
    store_rows8(records, base, layout.RECORD, (mx, my, l11, l21, l22, log2_opacity, none, none))
    store_rows8(records, base + LANES, layout.RECORD, (none, t0, tx, ty, nx, ny, nz, limit))
    return bits8(~finite)


@internal(error_model="numpy")
def color_rows(inputs, rest, degree, view, rows, records, basis, coefficients):
    """Write the colours of eight Gaussians, given by their indices, to their records; returns the lanes gone
    non-finite."""
    means, _, _, _, sh_dc, sh_rest, _, _, _ = inputs
    eye = layout.CENTRE
    dx = gather8_at(means, rows, 3, 0) - view[eye]
    dy = gather8_at(means, rows, 3, 1) - view[eye + 1]
    dz = gather8_at(means, rows, 3, 2) - view[eye + 2]
    red, green, blue = color8(sh_dc, sh_rest, rest, degree, rows, dx, dy, dz, basis, coefficients)
    scatter8_at(records, rows, layout.RECORD, layout.RED, max8(red, ZERO))
    scatter8_at(records, rows, layout.RECORD, layout.GREEN, max8(green, ZERO))
    scatter8_at(records, rows, layout.RECORD, layout.BLUE, max8(blue, ZERO))
    return bits8(~((red - red) + (green - green) + (blue - blue) == ZERO))


@internal(error_model="numpy")
def project_blocks(inputs, rest, tails, degree, geometry, view, first, stop, outputs):
    """Project the blocks first … stop - 1; returns the index of a Gaussian that is not finite, or -1."""
    n, margin = inputs[3].size, inputs[8]
    records, _, _, visible, counts = outputs
    bad = -1
    basis, coefficients = np.empty(TERMS * LANES, np.float32), np.empty(3 * TERMS * LANES, np.float32)
    # Visible Gaussians whose colour is still to come: only theirs is computed, eight at a time. They wait until eight
    # more have come, while memory sends their coefficients.
    rows, waiting = np.empty(3 * LANES, np.int32), 0
    for block in range(first, stop):
        i = block * LANES
        # One call with selected arguments, since a second call would compile a second copy.
        place, eight = (i, inputs) if i + LANES <= n else (0, tails)
        lost = project_block(eight, geometry, view, place, outputs, i)
        for lane in range(min(LANES, n - i)):
            if (lost >> lane) & 1:
                bad = i + lane
            met = 0
            if visible[i + lane]:
                met = count_tiles(records, i + lane, view) if margin.size == 0 else 1
                rows[waiting] = i + lane
                waiting += 1
                prefetch_terms(inputs[5], rest, i + lane)
            counts[i + lane] = met
        for k in range(n, i + LANES):
            visible[k] = False
            counts[k] = 0
        while waiting >= 2 * LANES or (waiting > 0 and block == stop - 1):
            for k in range(waiting, LANES):  # fills the last eight up with copies
                rows[k] = rows[waiting - 1]
            lost = color_rows(inputs, rest, degree, view, rows, records, basis, coefficients)
            for lane in range(LANES):
                if (lost >> lane) & 1:
                    bad = rows[lane]
            waiting = max(waiting - LANES, 0)
            for k in range(waiting):
                rows[k] = rows[k + LANES]
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
