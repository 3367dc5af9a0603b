"""Triton kernel of blending's gradient: one program for each chunk of a tile's list, nearest first once more.

Where a chunk begins, the tile's sums are those that blending has kept. One program for a whole list had the GPU wait
for the longest list, nine tenths of the time (docs/notes/gpu.md).

The pixel's loss to first order is S = sum of weight times s over its Gaussians, plus the background's part, with
s = colour . g_color + g_alpha' + t g_t + n . g_normal. The mean depth doesn't change when all weights are scaled, so
its part of S vanishes and S follows from the images alone. Distortion is of second degree in the weights, so its part
is twice itself; its s is g A (m - mean)**2 + g D / A, of which the second term is the same for every Gaussian and goes
into g_alpha'.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import gpu_layout as layout
from .gpu_blend import cosine_of, exponent_at, first_chunk, mean_of, pixels_of, pixels_within, ray_length_at


@triton.jit
def given(gradient, at, inside, used, bit: tl.constexpr):
    """An output's gradient at the pixels, zero where the loss doesn't use the output."""
    return tl.load(gradient + at, mask=tl.where(inside, (used >> bit) % 2, 0) != 0, other=0.0)


@triton.jit
def across(values):
    """Sum over the rows of one thread's pixels."""
    return tl.sum(values, 0)


@triton.jit
def tile_of(starts, chunk, tiles, steps):
    """The last of `tiles` tiles whose first chunk isn't behind `chunk`. steps: binary digits of `tiles`."""
    low, high = 0, tiles  # the tile lies from low on, and before high
    for _ in range(steps):
        middle = (low + high) // 2
        before = (first_chunk(tl.load(starts + middle), middle) <= chunk) & (high - low > 1)
        low = tl.where(before, middle, low)
        high = tl.where(before | (high - low <= 1), high, middle)
    return low


@triton.jit
def blend_backward(
    records, radius, view, starts, ids, slots, looked_at, kept, color, alpha, depth, median_at, normal, distortion,
    mean_inverse, g_color, g_alpha, g_depth, g_median, g_normal, g_distortion, out, used, width, height, tiles, places,
    steps,
    EACH: tl.constexpr, LEVEL: tl.constexpr, MOVED: tl.constexpr, ABSOLUTE: tl.constexpr, S_ABSOLUTE: tl.constexpr,
    S_NORMAL: tl.constexpr, SLOT: tl.constexpr,
):  # fmt: skip
    """Write the contribution of every intersection to the gradient to its place in `out`, SLOT numbers each, which is
    zero before.

    slots: each intersection's place, since a Gaussian's are adjacent there. used: bit k for the kth output's gradient,
    which may be anything where the bit is 0. LEVEL: of geometry that the loss uses. places: the tiles of all images,
    `steps` binary digits. kept, EACH: see `gpu_blend.blend`."""
    chunk = tl.program_id(0)
    place = tile_of(starts, chunk, places, steps)
    first = tl.load(starts + place)
    end = first + tl.load(looked_at + place)
    begin = first + (chunk - first_chunk(first, place)) * layout.CHUNK
    if begin >= end:
        return
    end = tl.minimum(end, begin + layout.CHUNK)
    number = place // tiles
    column, row, inside, at = pixels_of(place - number * tiles, width, height)
    at = number.to(tl.int64) * width * height + at
    x, y = column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5
    near = tl.load(view + layout.NEAR)
    state = kept + chunk.to(tl.int64) * EACH * layout.PIXELS + pixels_within()
    zero = tl.zeros((layout.STRIPS, layout.LANES), tl.float32)
    left = tl.load(state + layout.K_LEFT * layout.PIXELS)
    covered = tl.load(alpha + at, mask=inside, other=0.0)
    some = tl.where(covered > 0.0, covered, 1.0)
    g_red, g_green = given(g_color, 3 * at, inside, used, 0), given(g_color, 3 * at + 1, inside, used, 0)
    g_blue, to_alpha = given(g_color, 3 * at + 2, inside, used, 0), given(g_alpha, at, inside, used, 1)
    # What is left of the pixel's loss behind the Gaussians so far.
    loss = to_alpha * covered
    loss += g_red * (tl.load(color + 3 * at, mask=inside, other=0.0) - tl.load(state + layout.K_RED * layout.PIXELS))
    loss += g_green * (
        tl.load(color + 3 * at + 1, mask=inside, other=0.0) - tl.load(state + (layout.K_RED + 1) * layout.PIXELS)
    )
    loss += g_blue * (
        tl.load(color + 3 * at + 2, mask=inside, other=0.0) - tl.load(state + (layout.K_RED + 2) * layout.PIXELS)
    )
    before = 1.0 - left
    if EACH > layout.K_WEIGHTS:
        before = tl.load(state + layout.K_WEIGHTS * layout.PIXELS)
    to_depth, to_median, to_nx, to_ny, to_nz, to_spread, mean = zero, zero, zero, zero, zero, zero, zero
    medians_at = tl.zeros((layout.STRIPS, layout.LANES), tl.int32)
    if LEVEL > 0:
        cosine = cosine_of(view, column, row)
        to_depth = given(g_depth, at, inside, used, 2) / some
        to_alpha -= to_depth * tl.load(depth + at, mask=inside, other=0.0)
        to_depth = to_depth * cosine
        loss -= to_depth * tl.load(state + layout.K_DEPTHS * layout.PIXELS)
        if LEVEL > 1:
            to_median = given(g_median, at, inside, used, 3) * cosine
            medians_at = tl.load(median_at + at, mask=inside, other=0)
            to_nx, to_ny = given(g_normal, 3 * at, inside, used, 4), given(g_normal, 3 * at + 1, inside, used, 4)
            to_nz = given(g_normal, 3 * at + 2, inside, used, 4)
            towards = normal + 3 * at
            loss += to_nx * (tl.load(towards, mask=inside, other=0.0) - tl.load(state + layout.K_NX * layout.PIXELS))
            loss += to_ny * (
                tl.load(towards + 1, mask=inside, other=0.0) - tl.load(state + (layout.K_NX + 1) * layout.PIXELS)
            )
            loss += to_nz * (
                tl.load(towards + 2, mask=inside, other=0.0) - tl.load(state + (layout.K_NX + 2) * layout.PIXELS)
            )
            if LEVEL > 2:
                to_spread = given(g_distortion, at, inside, used, 5)
                spread = tl.load(distortion + at, mask=inside, other=0.0)
                loss += 2.0 * to_spread * spread
                to_alpha += to_spread * spread / some
                to_spread = to_spread * covered / (cosine * cosine)
                mean = tl.load(mean_inverse + at, mask=inside, other=0.0)
                apart = mean - tl.load(state + layout.K_ORIGIN * layout.PIXELS)
                moments = apart * apart * before - 2.0 * apart * tl.load(state + layout.K_FIRST * layout.PIXELS)
                loss -= to_spread * (moments + tl.load(state + layout.K_SECOND * layout.PIXELS))
    loss -= to_alpha * before

    lens_x, lens_y = tl.load(view + layout.POINTS + 2 * number), tl.load(view + layout.POINTS + 2 * number + 1)
    following = tl.load(ids + begin)  # asked for one Gaussian ahead, since its record can't be before it is there
    for j in range(begin, end):
        i = following
        following = tl.load(ids + j + 1, mask=j + 1 < end, other=0)
        record = records + i * layout.RECORD
        mx, my = mean_of(record, radius, view, i, number, MOVED)
        dx, dy = x - mx, y - my
        exponent, d, e = exponent_at(record, dx, dy)
        taken = (exponent >= tl.load(record + layout.LIMIT)) & (left >= layout.MIN_TRANSMITTANCE)
        # Many Gaussians of a tile's list reach only its corner, or lie behind what hides them.
        if tl.max(tl.max(taken.to(tl.int32), 0), 0) > 0:
            share = tl.where(taken, tl.minimum(tl.exp2(exponent), layout.MAX_ALPHA), 0.0)
            weight = share * left
            s = to_alpha + g_red * tl.load(record + layout.RED)
            s += g_green * tl.load(record + layout.RED + 1)
            s += g_blue * tl.load(record + layout.RED + 2)
            slot = out + tl.load(slots + j) * SLOT
            if LEVEL > 0:
                t = ray_length_at(record, dx, dy)
                held = tl.maximum(t, near)
                s += to_depth * held
                g_t = weight * to_depth
                if LEVEL > 1:
                    g_t += tl.where(medians_at == j - first + 1, to_median, 0.0)
                    s += to_nx * tl.load(record + layout.NX) + to_ny * tl.load(record + layout.NX + 1)
                    s += to_nz * tl.load(record + layout.NX + 2)
                    tl.store(slot + S_NORMAL, tl.sum(across(weight * to_nx), 0))
                    tl.store(slot + S_NORMAL + 1, tl.sum(across(weight * to_ny), 0))
                    tl.store(slot + S_NORMAL + 2, tl.sum(across(weight * to_nz), 0))
                    if LEVEL > 2:
                        inverse = 1.0 / held
                        apart = inverse - mean
                        s += to_spread * apart * apart
                        g_t -= 2.0 * weight * to_spread * apart * inverse * inverse
                g_t = tl.where(t > near, g_t, 0.0)
            loss -= weight * s
            by_alpha = left * s - loss / (1.0 - share)
            left = tl.fma(-share, left, left)
            # An alpha that is held at its largest passes no gradient on.
            q = tl.where(exponent < layout.LOG2_MAX_ALPHA, by_alpha * share, 0.0)

            # dx is one number within a thread, so its moments are taken of the threads' sums.
            by = tl.max(dx, 0)
            q0, q1, q2 = across(q), across(q * dy), across(q * dy * dy)
            q_x, q_y = tl.sum(q0 * by, 0), tl.sum(q1, 0)
            tl.store(slot + layout.Q, tl.sum(q0, 0))
            tl.store(slot + layout.QX, q_x)
            tl.store(slot + layout.QXX, tl.sum(q0 * by * by, 0))
            tl.store(slot + layout.QY, q_y)
            tl.store(slot + layout.QXY, tl.sum(q1 * by, 0))
            tl.store(slot + layout.QYY, tl.sum(q2, 0))
            tl.store(slot + layout.S_RED, tl.sum(across(weight * g_red), 0))
            tl.store(slot + layout.S_RED + 1, tl.sum(across(weight * g_green), 0))
            tl.store(slot + layout.S_RED + 2, tl.sum(across(weight * g_blue), 0))
            if LEVEL > 0:
                by_t = across(g_t)
                tl.store(slot + layout.S_T, tl.sum(by_t, 0))
                tl.store(slot + layout.S_T + 1, tl.sum(by_t * by, 0))
                tl.store(slot + layout.S_T + 2, tl.sum(across(g_t * dy), 0))
            if MOVED:
                tl.store(slot + layout.S_T, lens_x * q_x)
                tl.store(slot + layout.S_T + 1, lens_x * q_y + lens_y * q_x)
                tl.store(slot + layout.S_T + 2, lens_y * q_y)
            if ABSOLUTE:
                to_x = q * d * (tl.load(record + layout.L11) * layout.TWO_LN2)
                to_y = q * layout.TWO_LN2 * (d * tl.load(record + layout.L21) + tl.load(record + layout.L22) * e)
                if LEVEL > 0:
                    to_x += g_t * tl.load(record + layout.TX)
                    to_y += g_t * tl.load(record + layout.TY)
                tl.store(slot + S_ABSOLUTE, tl.sum(across(tl.abs(to_x)), 0))
                tl.store(slot + S_ABSOLUTE + 1, tl.sum(across(tl.abs(to_y)), 0))
