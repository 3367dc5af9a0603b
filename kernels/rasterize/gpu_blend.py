"""Triton kernel of blending: one program for each tile, over its Gaussians, nearest first."""

from __future__ import annotations

import triton
import triton.language as tl

from . import gpu_layout as layout

# After so many Gaussians it is tested whether the whole tile is opaque; a divisor of CHUNK.
_TEST_EVERY = tl.constexpr(16)
_AT_ONCE = tl.constexpr(4)


@triton.jit
def pixels_of(tile, width, height):
    """The tile's pixels: column (1, 32), row (8, 32), whether they lie in the image, and index in the image."""
    columns = (width + layout.TILE - 1) // layout.TILE
    lane, strip = tl.arange(0, layout.LANES)[None, :], tl.arange(0, layout.STRIPS)[:, None]
    column = tile % columns * layout.TILE + lane % layout.TILE
    row = tile // columns * layout.TILE + (layout.LANES // layout.TILE) * strip + lane // layout.TILE
    return column, row, (column < width) & (row < height), row * width + column


@triton.jit
def mean_of(record, radius, view, i, number, MOVED: tl.constexpr):
    """The Gaussian's mean in a image, pixels."""
    mx, my = tl.load(record + layout.MX), tl.load(record + layout.MY)
    if MOVED:
        shift = tl.load(radius + i)
        mx = tl.fma(shift, tl.load(view + layout.POINTS + 2 * number), mx)
        my = tl.fma(shift, tl.load(view + layout.POINTS + 2 * number + 1), my)
    return mx, my


@triton.jit
def exponent_at(record, dx, dy):
    """log2(alpha) at pixel - mean, and the two whitened coordinates whose squares it loses.

    Fused by hand: forward and backward pass must agree to the last bit on where a Gaussian counts.
    """
    e = tl.load(record + layout.L22) * dy
    d = tl.fma(dy, tl.load(record + layout.L21), tl.load(record + layout.L11) * dx)
    return tl.fma(-d, d, tl.fma(-e, e, tl.load(record + layout.LOG2_OPACITY))), d, e


@triton.jit
def ray_length_at(record, dx, dy):
    """Ray length at pixel - mean, on the Gaussian's plane of largest density."""
    return tl.fma(
        -dy, tl.load(record + layout.TY), tl.fma(-dx, tl.load(record + layout.TX), tl.load(record + layout.T0))
    )


@triton.jit
def cosine_of(view, column, row):
    """Cosine between the optical axis and a pixel's ray: z-depth over ray length."""
    u = (column.to(tl.float32) + 0.5 - tl.load(view + layout.CX)) / tl.load(view + layout.FX)
    v = (row.to(tl.float32) + 0.5 - tl.load(view + layout.CY)) / tl.load(view + layout.FY)
    return 1.0 / tl.sqrt(u * u + (v * v + 1.0))


@triton.jit
def first_chunk(begin, place):
    """The first chunk of a tile's list, which begins at `begin`: those of all tiles lie behind each other, and no tile
    has to know how many chunks the others have. Their number is at most that of the intersections over CHUNK, and one
    for each tile."""
    return begin // layout.CHUNK + place


@triton.jit
def pixels_within():
    """Each of a tile's pixels by its number in the tile, (8, 32)."""
    return tl.arange(0, layout.STRIPS)[:, None] * layout.LANES + tl.arange(0, layout.LANES)[None, :]


@triton.jit
def blend(
    records, radius, view, background, starts, ids, color, alpha, depth, median, median_at, normal, distortion,
    mean_inverse, looked_at, kept, width, height, tiles,
    GEOMETRY: tl.constexpr, MOVED: tl.constexpr, EACH: tl.constexpr,
):  # fmt: skip
    """Composite every tile, writing the images and how many Gaussians each tile processed.

    kept: (chunks, EACH, 256), the sums before each chunk; where EACH is 0 none are kept, as no gradient is wanted.

    GEOMETRY: 0 for colour and alpha, 1 to add depth, 2 to add median depth and normals, 3 to add distortion; images
    beyond may be anything. median_at: the number in the tile's list, from 1, of the Gaussian with the median depth.
    mean_inverse: the mean of the inverse ray lengths, which the backward pass needs for distortion.
    """
    place = tl.program_id(0)
    number = place // tiles
    column, row, inside, at = pixels_of(place - number * tiles, width, height)
    x, y = column.to(tl.float32) + 0.5, row.to(tl.float32) + 0.5
    near = tl.load(view + layout.NEAR)
    begin, end = tl.load(starts + place), tl.load(starts + place + 1)

    zero = tl.zeros((layout.STRIPS, layout.LANES), tl.float32)
    left = tl.where(inside, 1.0, zero)
    red, green, blue, weights, depths, medians = zero, zero, zero, zero, zero, zero
    medians_at = tl.zeros((layout.STRIPS, layout.LANES), tl.int32)
    nx, ny, nz, origin, first_moment, second_moment = zero, zero, zero, zero, zero, zero
    k = begin
    while k < end:
        if EACH > 0:  # noqa: SIM102  # known when it is compiled
            if (k - begin) % layout.CHUNK == 0:
                chunk = first_chunk(begin, place) + (k - begin) // layout.CHUNK
                state = kept + chunk.to(tl.int64) * EACH * layout.PIXELS + pixels_within()
                tl.store(state + layout.K_LEFT * layout.PIXELS, left)
                tl.store(state + layout.K_RED * layout.PIXELS, red)
                tl.store(state + (layout.K_RED + 1) * layout.PIXELS, green)
                tl.store(state + (layout.K_RED + 2) * layout.PIXELS, blue)
                if GEOMETRY > 0:
                    tl.store(state + layout.K_WEIGHTS * layout.PIXELS, weights)
                    tl.store(state + layout.K_DEPTHS * layout.PIXELS, depths)
                    if GEOMETRY > 1:
                        tl.store(state + layout.K_NX * layout.PIXELS, nx)
                        tl.store(state + (layout.K_NX + 1) * layout.PIXELS, ny)
                        tl.store(state + (layout.K_NX + 2) * layout.PIXELS, nz)
                        if GEOMETRY > 2:
                            tl.store(state + layout.K_ORIGIN * layout.PIXELS, origin)
                            tl.store(state + layout.K_FIRST * layout.PIXELS, first_moment)
                            tl.store(state + layout.K_SECOND * layout.PIXELS, second_moment)
        stop = tl.minimum(k + _TEST_EVERY, end)
        # Unrolled, so that several Gaussians are asked for at once: a tile's time is mostly waiting for them.
        for j in tl.range(k, stop, loop_unroll_factor=_AT_ONCE):
            i = tl.load(ids + j)
            record = records + i * layout.RECORD
            mx, my = mean_of(record, radius, view, i, number, MOVED)
            dx, dy = x - mx, y - my
            exponent, _, _ = exponent_at(record, dx, dy)
            taken = (exponent >= tl.load(record + layout.LIMIT)) & (left >= layout.MIN_TRANSMITTANCE)
            share = tl.where(taken, tl.minimum(tl.exp2(exponent), layout.MAX_ALPHA), 0.0)
            weight = share * left
            red += weight * tl.load(record + layout.RED)
            green += weight * tl.load(record + layout.RED + 1)
            blue += weight * tl.load(record + layout.RED + 2)
            if GEOMETRY > 0:
                t = tl.maximum(ray_length_at(record, dx, dy), near)
                depths += weight * t
                if GEOMETRY > 1:
                    nx += weight * tl.load(record + layout.NX)
                    ny += weight * tl.load(record + layout.NX + 1)
                    nz += weight * tl.load(record + layout.NX + 2)
                    upper = taken & (left > 0.5)
                    medians = tl.where(upper, t, medians)
                    medians_at = tl.where(upper, j - begin + 1, medians_at)
                    if GEOMETRY > 2:
                        # Moments about the inverse ray length of the first Gaussian that counts: it has a share of the
                        # weight, so its distance from the mean is bounded by the spread, and their difference
                        # keeps its digits. About 0 it would lose them all where the ray meets one surface.
                        inverse = 1.0 / t
                        origin = tl.where(taken & (weights == 0.0), inverse, origin)
                        moment = weight * (inverse - origin)
                        first_moment += moment
                        second_moment += moment * (inverse - origin)
                weights += weight
            left = tl.fma(-share, left, left)
        k = stop
        end = tl.where(tl.max(tl.max(left, 1), 0) < layout.MIN_TRANSMITTANCE, k, end)
    tl.store(looked_at + place, k - begin)

    at = number.to(tl.int64) * width * height + at
    # A sum of weights keeps the digits of a faint alpha, by which depth is divided in the gradient.
    covered = 1.0 - left
    if GEOMETRY > 0:
        covered = tl.minimum(weights, 1.0)
    tl.store(color + 3 * at, tl.fma(left, tl.load(background), red), mask=inside)
    tl.store(color + 3 * at + 1, tl.fma(left, tl.load(background + 1), green), mask=inside)
    tl.store(color + 3 * at + 2, tl.fma(left, tl.load(background + 2), blue), mask=inside)
    tl.store(alpha + at, covered, mask=inside)
    if GEOMETRY > 0:
        cosine = cosine_of(view, column, row)
        some = tl.where(weights == 0.0, 1.0, weights)
        tl.store(depth + at, depths / some * cosine, mask=inside)
        if GEOMETRY > 1:
            tl.store(median + at, medians * cosine, mask=inside)
            tl.store(median_at + at, medians_at, mask=inside)
            tl.store(normal + 3 * at, nx, mask=inside)
            tl.store(normal + 3 * at + 1, ny, mask=inside)
            tl.store(normal + 3 * at + 2, nz, mask=inside)
            if GEOMETRY > 2:
                # Dividing by the pixel's cosine turns inverse ray lengths into disparities.
                spread = tl.maximum(weights * second_moment - first_moment * first_moment, 0.0)
                tl.store(distortion + at, spread / (cosine * cosine), mask=inside)
                tl.store(mean_inverse + at, origin + first_moment / some, mask=inside)
