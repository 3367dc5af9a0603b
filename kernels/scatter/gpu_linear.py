"""Triton kernels of the scatter's linear form: the sources of a window that count in full are added as one sum.

A tile of targets looks at sources through windows: a row `dy` away, and FINE or COARSE neighbouring offsets across it.
The sources that all targets of the tile see through a window, and their offsets, lie within bounds. From these it
follows for most windows that no source reaches its target, or that every source counts in full (or is behind the
central stop). The first are skipped, and of the second the sum over the window is added, which lies ready for every
place of a window. Only a window that a rim may cross is gone through pixel by pixel. These lie along the rims: where
neighbours have similar radii a pixel has a multiple of R of these, and besides some 3 R^2 / COARSE sums to add, each
dearer than a pixel of the direct form by the comparisons before it. It is right for any radii; where neighbours have
nothing in common it is the direct form with comparisons in vain.

Nothing is ever taken away from a sum, so that highlights leave no trace in float32, and nothing is added by atomics.

In the gradient a tile's own sources are on one side of every pair, so that one set of bounds a tile tells a window's
kind. Where a weight is constant, it doesn't change with the radius either, and a window's sums of what weights are
worth are all that is needed.
"""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_direct import store_gradient, store_light, with_source, with_target
from .gpu_rim import LOG2_E
from .gpu_row_windows import bounds_through, common_weight, radii_through, sums_through


@triton.jit
def gather_windows(
    planes, fine_sums, coarse_sums, fine_bounds, coarse_bounds, window, blurred, total, height, width, coarse_columns,
    linear_from, steepest, alpha, factors, obstruction,
    SHAPED: tl.constexpr, STOPPED: tl.constexpr, TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
    FINE: tl.constexpr, COARSE: tl.constexpr,
):  # fmt: skip
    """Each target's colour, and the sum of weights that it was divided by, in tiles that sources reach from
    `linear_from` pixels away or more.

    fine_sums, coarse_sums: of the last four planes over windows (`add_windows`). fine_bounds, coarse_bounds:
    `region_bounds`; their first window starts TILE_X + COARSE before the image. window: `tile_window` (gpu_direct.py).
    """
    far = tl.load(window + tl.program_id(0) * tl.num_programs(1) + tl.program_id(1))
    if far < linear_from:
        return
    top, left = tl.program_id(0) * TILE_Y, tl.program_id(1) * TILE_X
    y = top + tl.arange(0, TILE_Y)[:, None]
    x = left + tl.arange(0, TILE_X)[None, :]
    steepness = 2.0 * alpha * LOG2_E
    region_rows = height + (TILE_Y - 1)
    red = tl.zeros((TILE_Y, TILE_X), tl.float32)
    green = tl.zeros((TILE_Y, TILE_X), tl.float32)
    blue = tl.zeros((TILE_Y, TILE_X), tl.float32)
    weights = tl.zeros((TILE_Y, TILE_X), tl.float32)
    rows = tl.minimum(far, height - 1)
    for dy in range(tl.maximum(-rows, -top - (TILE_Y - 1)), tl.minimum(rows, height - 1 - top) + 1):
        columns = tl.minimum(tl.sqrt((far * far - dy * dy).to(tl.float32)).to(tl.int32) + 1, width - 1)
        row = y + dy
        region = top + dy + (TILE_Y - 1)
        # From the multiple of COARSE at or before the first column that the tile has sources in.
        begin = tl.maximum(-columns, -left - (TILE_X + COARSE - 2)) & -COARSE
        for coarse in range(begin, tl.minimum(columns, width - 1 - left) + 1, COARSE):
            place = (left + coarse + (TILE_X + COARSE)) // COARSE
            near, gone, hole_near, hole_far = bounds_through(coarse_bounds, region, place, region_rows, coarse_columns)
            # Seen from the source, the target lies in the opposite direction.
            least, most = radii_through(-coarse - (COARSE - 1), -dy, factors, steepest, height, width, SHAPED, COARSE)
            if gone >= least:
                even = common_weight(least, most, near, hole_near, hole_far, STOPPED)
                if even >= 0.0:
                    r, g, b, w = sums_through(coarse_sums, row, x + coarse, height, width, COARSE)
                    red += even * r
                    green += even * g
                    blue += even * b
                    weights += even * w
                else:
                    for fine in range(coarse, coarse + COARSE, FINE):
                        place = (left + fine + (TILE_X + COARSE)) // FINE
                        near, gone, hole_near, hole_far = bounds_through(
                            fine_bounds, region, place, region_rows, coarse_columns * (COARSE // FINE)
                        )
                        least, most = radii_through(
                            -fine - (FINE - 1), -dy, factors, steepest, height, width, SHAPED, FINE
                        )
                        if gone >= least:
                            even = common_weight(least, most, near, hole_near, hole_far, STOPPED)
                            if even >= 0.0:
                                r, g, b, w = sums_through(fine_sums, row, x + fine, height, width, FINE)
                                red += even * r
                                green += even * g
                                blue += even * b
                                weights += even * w
                            else:
                                for dx in range(fine, fine + FINE):
                                    red, green, blue, weights = with_source(
                                        red, green, blue, weights, planes, x, row, dx, dy, height, width,
                                        steepness, factors, obstruction, SHAPED, STOPPED,
                                    )  # fmt: skip
    store_light(red, green, blue, weights, blurred, total, y, x, height, width)


@triton.jit
def gather_gradient_windows(
    targets, fine_sums, coarse_sums, reach, bounds, image, signed_radius, by_image, by_radius, height, width,
    linear_from, steepest, alpha, factors, obstruction,
    AREA: tl.constexpr, SHAPED: tl.constexpr, STOPPED: tl.constexpr, TILE_Y: tl.constexpr, TILE_X: tl.constexpr,
    FINE: tl.constexpr, COARSE: tl.constexpr,
):  # fmt: skip
    """Gradients of the sources in tiles that reach `linear_from` pixels or more; sums as in `gather_gradient`
    (gpu_direct.py).

    targets: `pack_targets`; fine_sums, coarse_sums: of these over windows (`add_windows`). reach, bounds: `tile_reach`.
    """
    tile, tiles = tl.program_id(0) * tl.num_programs(1) + tl.program_id(1), tl.num_programs(0) * tl.num_programs(1)
    far = tl.ceil(tl.load(reach + tile)).to(tl.int32)
    if far < linear_from:
        return
    near, gone = tl.load(bounds + tile), tl.load(bounds + tiles + tile)
    hole_near, hole_far = tl.load(bounds + 2 * tiles + tile), tl.load(bounds + 3 * tiles + tile)
    top, left = tl.program_id(0) * TILE_Y, tl.program_id(1) * TILE_X
    y = top + tl.arange(0, TILE_Y)[:, None]
    x = left + tl.arange(0, TILE_X)[None, :]
    inside = (y < height) & (x < width)
    own = y * width + x
    signed = tl.load(signed_radius + own, mask=inside, other=0.0)
    radius = tl.abs(signed)
    own_red = tl.load(image + own * 3, mask=inside, other=0.0)
    own_green = tl.load(image + own * 3 + 1, mask=inside, other=0.0)
    own_blue = tl.load(image + own * 3 + 2, mask=inside, other=0.0)
    red = tl.zeros((TILE_Y, TILE_X), tl.float32)
    green = tl.zeros((TILE_Y, TILE_X), tl.float32)
    blue = tl.zeros((TILE_Y, TILE_X), tl.float32)
    costs = tl.zeros((TILE_Y, TILE_X), tl.float32)
    by_rim = tl.zeros((TILE_Y, TILE_X), tl.float32)
    rows = tl.minimum(far, height - 1)
    for dy in range(tl.maximum(-rows, -top - (TILE_Y - 1)), tl.minimum(rows, height - 1 - top) + 1):
        columns = tl.minimum(tl.sqrt((far * far - dy * dy).to(tl.float32)).to(tl.int32) + 1, width - 1)
        row = y + dy
        begin = tl.maximum(-columns, -left - (TILE_X + COARSE - 2)) & -COARSE
        for coarse in range(begin, tl.minimum(columns, width - 1 - left) + 1, COARSE):
            least, most = radii_through(coarse, dy, factors, steepest, height, width, SHAPED, COARSE)
            if gone >= least:
                even = common_weight(least, most, near, hole_near, hole_far, STOPPED)
                if even >= 0.0:
                    r, g, b, c = sums_through(coarse_sums, row, x + coarse, height, width, COARSE)
                    red += even * r
                    green += even * g
                    blue += even * b
                    costs += even * c
                else:
                    for fine in range(coarse, coarse + COARSE, FINE):
                        least, most = radii_through(fine, dy, factors, steepest, height, width, SHAPED, FINE)
                        if gone >= least:
                            even = common_weight(least, most, near, hole_near, hole_far, STOPPED)
                            if even >= 0.0:
                                r, g, b, c = sums_through(fine_sums, row, x + fine, height, width, FINE)
                                red += even * r
                                green += even * g
                                blue += even * b
                                costs += even * c
                            else:
                                for dx in range(fine, fine + FINE):
                                    red, green, blue, costs, by_rim = with_target(
                                        red, green, blue, costs, by_rim, targets, x, row, dx, dy, height, width,
                                        radius, own_red, own_green, own_blue, alpha, factors, obstruction,
                                        SHAPED, STOPPED,
                                    )  # fmt: skip
    store_gradient(
        red, green, blue, costs, by_rim, own_red, own_green, own_blue, signed, by_image, by_radius, own, inside, AREA
    )
