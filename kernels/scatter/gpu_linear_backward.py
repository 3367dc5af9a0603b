"""Triton kernel of the linear form's gradient: each source gathers from windows of targets, as in gpu_linear.py.

Here a tile's own sources are on one side of every pair, so that one set of bounds a tile tells a window's kind. Where a
weight is constant, it doesn't change with the radius either, and a window's sums of what weights are worth are all that
is needed.
"""

from __future__ import annotations

import triton
import triton.language as tl

from .gpu_direct import store_gradient, with_target
from .gpu_row_windows import common_weight, radii_through, sums_through


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
