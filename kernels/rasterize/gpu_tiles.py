"""Triton kernels that assign Gaussians to tiles: how many tiles each one meets, and which.

The tiles that an ellipse meets in one row of tiles are neighbours, so a Gaussian's tiles are numbered row by row. Both
kernels must agree on them to the last bit. So everything that decides about a tile is written with fused products and
exactly rounded roots and quotients, which leaves the compiler no choice of how to round.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import gpu_layout as layout


@triton.jit
def ellipse(records, i, mask):
    """Where the Gaussian counts: its mean, the factor L, and the square of its reach in base-2 exponent."""
    base = records + i * layout.RECORD
    reach2 = tl.load(base + layout.LOG2_OPACITY, mask=mask, other=0.0) - tl.load(
        base + layout.LIMIT, mask=mask, other=0.0
    )
    return (
        tl.load(base + layout.MX, mask=mask, other=0.0), tl.load(base + layout.MY, mask=mask, other=0.0),
        tl.load(base + layout.L11, mask=mask, other=1.0), tl.load(base + layout.L21, mask=mask, other=0.0),
        tl.load(base + layout.L22, mask=mask, other=1.0), tl.maximum(reach2, 0.0),
    )  # fmt: skip


@triton.jit
def half_height(l22, reach2):
    """How far the ellipse reaches up and down from its centre, pixels."""
    return tl.div_rn(tl.sqrt_rn(reach2), l22)


@triton.jit
def covers(mx, my, l11, l21, l22, reach2, width, height):
    """Whether the box around the ellipse may hold a pixel's centre."""
    half_y = half_height(l22, reach2)
    half_x = half_y * tl.sqrt(l21 * l21 + l22 * l22) / l11
    left, right = tl.maximum(tl.ceil(mx - half_x - 0.5), 0.0), tl.minimum(tl.floor(mx + half_x - 0.5), width - 1.0)
    top, bottom = tl.maximum(tl.ceil(my - half_y - 0.5), 0.0), tl.minimum(tl.floor(my + half_y - 0.5), height - 1.0)
    return (left <= right) & (top <= bottom)


@triton.jit
def rows_met(my, l22, reach2, height, mask):
    """The first and last row of tiles that the ellipse may meet; the last before the first where it meets none."""
    half = half_height(l22, reach2 + layout.SLACK)
    top = tl.maximum(tl.ceil(my - half - 0.5 - layout.SLACK), 0.0)
    bottom = tl.minimum(tl.floor(my + half - 0.5 + layout.SLACK), height - 1.0)
    met = mask & (top <= bottom)
    first = tl.where(met, top, 0.0).to(tl.int32) // layout.TILE
    return first, tl.where(met, tl.where(met, bottom, 0.0).to(tl.int32) // layout.TILE, first - 1)


@triton.jit
def columns_met(mx, my, l11, l21, l22, reach2, row, width, height):
    """The first tile that the ellipse meets in a row of tiles, and how many it meets there.

    The ellipse is (l11 dx + l21 dy)**2 + (l22 dy)**2 <= reach2. Its right and left sides are
    dx = (-l21 dy +- sqrt(reach2 - (l22 dy)**2)) / l11, a concave and a convex function of dy whose extremes lie at
    dy = -+ l21 sqrt(reach2) / (l22 sqrt(l21**2 + l22**2)): so over the row's pixels the extreme is at the dy nearest to
    this one.
    """
    reach2 = reach2 + layout.SLACK
    half = half_height(l22, reach2)
    above = (row * layout.TILE).to(tl.float32)
    low = tl.maximum(above + 0.5 - my - layout.SLACK, -half)
    high = tl.minimum(tl.minimum(above + (layout.TILE - 0.5), height - 0.5) - my + layout.SLACK, half)
    turn = tl.div_rn(l21 * half, tl.sqrt_rn(tl.fma(l21, l21, l22 * l22)))
    at = tl.minimum(tl.maximum(turn, low), high)
    e = l22 * at
    left = tl.div_rn(tl.fma(-l21, at, -tl.sqrt_rn(tl.maximum(tl.fma(-e, e, reach2), 0.0))), l11)
    at = tl.minimum(tl.maximum(-turn, low), high)
    e = l22 * at
    right = tl.div_rn(tl.fma(-l21, at, tl.sqrt_rn(tl.maximum(tl.fma(-e, e, reach2), 0.0))), l11)
    first = tl.maximum(tl.ceil(mx + left - 0.5 - layout.SLACK), 0.0)
    last = tl.minimum(tl.floor(mx + right - 0.5 + layout.SLACK), width - 1.0)
    met = (low <= high) & (first <= last)
    first = tl.where(met, first, 0.0).to(tl.int32) // layout.TILE
    return first, tl.where(met, tl.where(met, last, 0.0).to(tl.int32) // layout.TILE - first + 1, 0)


@triton.jit(do_not_specialize=["n"])
def count(records, radius, view, radii, visible, counts, n, views, MOVED: tl.constexpr, BLOCK: tl.constexpr):
    """How many tiles each Gaussian meets in each image, and whether it is visible in any; one thread for each.

    counts: (N, views). radii: of `gpu_project.project`; that of a Gaussian which isn't visible becomes 0.
    """
    i = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = i < n
    size = tl.load(radii + i, mask=inside, other=0.0)
    candidate = size > 0.0
    mx, my, l11, l21, l22, reach2 = ellipse(records, i, candidate)
    width, height = tl.load(view + layout.WIDTH), tl.load(view + layout.HEIGHT)
    shown = tl.zeros((BLOCK,), tl.int32)
    for number in range(0, views):
        x, y = mx, my
        if MOVED:
            shift = tl.load(radius + i, mask=candidate, other=0.0)
            x = tl.fma(shift, tl.load(view + layout.POINTS + 2 * number), mx)
            y = tl.fma(shift, tl.load(view + layout.POINTS + 2 * number + 1), my)
        here = candidate & covers(x, y, l11, l21, l22, reach2, width, height)
        shown = tl.where(here, 1, shown)
        first, last = rows_met(y, l22, reach2, height, here)
        total = tl.zeros((BLOCK,), tl.int32)
        for k in range(0, tl.max(last - first, 0) + 1):
            row = first + k
            _, met = columns_met(x, y, l11, l21, l22, reach2, row, width, height)
            total += tl.where(row <= last, met, 0)
        # Comparing with itself finds NaN, which stands for a Gaussian that isn't finite.
        tl.store(counts + i * views + number, tl.where(size != size, layout.BAD, total), mask=inside)
    tl.store(visible + i, shown != 0, mask=inside)
    tl.store(radii + i, tl.where(shown != 0, size, 0.0), mask=inside)


@triton.jit(do_not_specialize=["total", "entries", "steps"])
def fill(
    records, radius, view, order, ends, tiles, owners, total, entries, steps, views, columns, rows,
    MOVED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """For each intersection the number of its tile and its Gaussian; one thread for each intersection.

    order: (N,), the Gaussians, nearest first. ends: (N * views,), where each Gaussian's intersections in each image
    end, in this order. steps: at least log2 of one more than entries = N * views.
    """
    slot = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    inside = slot < total
    # The first entry that ends behind this intersection, by bisection.
    low, high = tl.zeros((BLOCK,), tl.int32), tl.zeros((BLOCK,), tl.int32) + entries
    for _ in range(0, steps):
        middle = low + (high - low) // 2
        searching = inside & (low < high)
        later = tl.load(ends + middle, mask=searching, other=0) <= slot
        low = tl.where(searching & later, middle + 1, low)
        high = tl.where(searching & (later == 0), middle, high)
    rank = low // views
    number = low - rank * views
    i = tl.load(order + rank, mask=inside, other=0).to(tl.int32)
    rest = (slot - tl.load(ends + low - 1, mask=inside & (low > 0), other=0)).to(tl.int32)

    mx, my, l11, l21, l22, reach2 = ellipse(records, i, inside)
    if MOVED:
        shift = tl.load(radius + i, mask=inside, other=0.0)
        mx = tl.fma(shift, tl.load(view + layout.POINTS + 2 * number, mask=inside, other=0.0), mx)
        my = tl.fma(shift, tl.load(view + layout.POINTS + 2 * number + 1, mask=inside, other=0.0), my)
    width, height = tl.load(view + layout.WIDTH), tl.load(view + layout.HEIGHT)
    first, last = rows_met(my, l22, reach2, height, inside)
    # Walk down the Gaussian's rows of tiles to the one that holds this intersection.
    tile = tl.zeros((BLOCK,), tl.int32)
    for k in range(0, tl.max(last - first, 0) + 1):
        row = first + k
        left, met = columns_met(mx, my, l11, l21, l22, reach2, row, width, height)
        met = tl.where(row <= last, met, 0)
        tile = tl.where((0 <= rest) & (rest < met), row * columns + left + rest, tile)
        rest -= met
    tl.store(tiles + slot, (number * columns * rows + tile).to(tiles.dtype.element_ty), mask=inside)
    tl.store(owners + slot, i, mask=inside)
