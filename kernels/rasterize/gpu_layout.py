"""Sizes, places and thresholds that the rasteriser's Triton kernels share."""

from __future__ import annotations

import math

import triton.language as tl

from . import gpu_inputs as inputs
from . import op

# Tiles are 16 pixels wide and high. A program holds a tile's 256 pixels as (8, 32): an entry's second index is its
# thread's place in the warp, and gives its column and whether its row is even or odd. So all pixels of one thread lie
# in one column, and a sum over the first index stays within a thread.
TILE = tl.constexpr(inputs.TILE)
STRIPS = tl.constexpr(8)
LANES = tl.constexpr(32)

# One Gaussian's record. At pixel offset (dx, dy) = pixel - mean,
#   log2(alpha) = log2(opacity) - (L11 dx + L21 dy)**2 - (L22 dy)**2,
# its exponent in Cholesky form and base 2, which rounding can't make positive as it can a needle's expanded quadratic
# form. It counts where log2(alpha) is at least LIMIT. Ray length there: T0 - TX dx - TY dy.
RECORD = tl.constexpr(inputs.RECORD)
MX, MY, L11, L21, L22, LOG2_OPACITY, LIMIT = (tl.constexpr(k) for k in range(7))
RED, T0, TX, TY, NX = (tl.constexpr(k) for k in (7, 10, 11, 12, 13))

# What blending's gradient writes for each intersection of a Gaussian with a tile: Q, dL/d(exponent) summed over
# pixels; its moments in (dx, dy); sums by colour. Behind them, as far as they are wanted, sums by ray length and by its
# slopes, or where a view is seen from points (px, py) of a lens the products px QX, px QY + py QX and py QY; sums of
# absolute values; sums by normal (`gpu_gradient.Slot`).
Q, QX, QXX, QY, QXY, QYY, S_RED, S_T = (tl.constexpr(k) for k in (0, 1, 2, 3, 4, 5, 6, 9))

# Blending keeps a tile's sums so far before every CHUNK Gaussians, from where its gradient goes on: a list's chunks are
# programs of their own there, which needn't wait for each other. For each pixel, as far as they are drawn
# (`gpu_inputs.KEPT`): transmittance, colour; weights and ray lengths; normals; inverse ray lengths, about the first of
# them (`gpu_blend`).
CHUNK = tl.constexpr(inputs.CHUNK)
PIXELS = tl.constexpr(inputs.TILE * inputs.TILE)
K_LEFT, K_RED, K_WEIGHTS, K_DEPTHS, K_NX, K_ORIGIN, K_FIRST, K_SECOND = (
    tl.constexpr(k) for k in (0, 1, 4, 5, 6, 9, 10, 11)
)

ROTATION, TRANSLATION, CENTRE = (
    tl.constexpr(inputs.ROTATION),
    tl.constexpr(inputs.TRANSLATION),
    tl.constexpr(inputs.CENTRE),
)
FX, FY, CX, CY = tl.constexpr(inputs.FX), tl.constexpr(inputs.FY), tl.constexpr(inputs.CX), tl.constexpr(inputs.CY)
WIDTH, HEIGHT = tl.constexpr(inputs.WIDTH), tl.constexpr(inputs.HEIGHT)
NEAR, FILTER_2D = tl.constexpr(inputs.NEAR), tl.constexpr(inputs.FILTER_2D)
U_LOW, U_HIGH = tl.constexpr(inputs.U_LOW), tl.constexpr(inputs.U_HIGH)
V_LOW, V_HIGH = tl.constexpr(inputs.V_LOW), tl.constexpr(inputs.V_HIGH)
POINTS = tl.constexpr(inputs.POINTS)

MAX_ALPHA = tl.constexpr(op.MAX_ALPHA)
MIN_ALPHA = tl.constexpr(op.MIN_ALPHA)
LOG2_MAX_ALPHA = tl.constexpr(math.log2(op.MAX_ALPHA))
LOG2_MIN_ALPHA = tl.constexpr(math.log2(op.MIN_ALPHA))
MIN_TRANSMITTANCE = tl.constexpr(op.MIN_TRANSMITTANCE)
MIN_DETERMINANT = tl.constexpr(op.MIN_DETERMINANT)
EDGE_ON = tl.constexpr(op.EDGE_ON)
# sqrt(log2(e) / 2): converts distances in standard deviations to the records' base-2 exponent.
EXPONENT_SCALE = tl.constexpr(math.sqrt(math.log2(math.e) / 2))
TWO_LN2 = tl.constexpr(2 * math.log(2))
# Bounds of an ellipse are widened by this, in base-2 exponent and in pixels, so that rounding leaves out no pixel that
# blending would use.
SLACK = tl.constexpr(1e-3)
BAD = tl.constexpr(inputs.BAD)
