"""Sizes and array layouts that the compiled stages share; the division of Gaussians into blocks of eight."""

from __future__ import annotations

import math

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd import LANES

from . import op

# Tiles are one vector wide, since wider ones waste lanes at the sides of small Gaussians, and have as many pixels as 16
# x 16.
TILE_WIDTH = LANES
TILE_HEIGHT = 32

# One Gaussian's record, a cache line of 16 floats. At pixel offset (dx, dy) = pixel - mean,
#   log2(alpha) = log2(opacity) - (L11 dx + L21 dy)**2 - (L22 dy)**2
# which is the Gaussian's exponent in Cholesky form and base 2: it can't become positive by rounding,
# as the expanded quadratic form of a needle does. It counts where log2(alpha) is at least LIMIT.
# Ray length there: T0 - TX dx - TY dy.
RECORD = 16
MX, MY, L11, L21, L22, LOG2_OPACITY, RED, GREEN, BLUE, T0, TX, TY, NX, NY, NZ, LIMIT = range(16)

# The record that the backward pass of blending writes for each intersection of a Gaussian with a tile.
# Q: dL/d(exponent) summed over pixels; QX … QYY its moments in (dx, dy); S_*: sums by feature.
# Sixteen floats, or 24 with normals.
SLOT = 24
# S_POINT_*: where a view is rendered from lens points, without depth: the products of the moments QX and QY with the
# lens point (px, py): px QX, px QY + py QX, py QY.
Q, QX, QXX, QY, QXY, QYY, S_RED, S_GREEN, S_BLUE, S_T, S_TX, S_TY, ABS_X, ABS_Y, S_NX, S_NY, S_NZ = range(17)
S_POINT_XX, S_POINT_XY, S_POINT_YY = S_T, S_TX, S_TY

# The camera and the constants of one view, one float32 each. FADES: 1 if the 2D filter lowers opacities, else 0.
VIEW = 32
ROTATION = 0
TRANSLATION = 9
CENTRE = 12
FX, FY, CX, CY, WIDTH, HEIGHT, NEAR, FILTER_2D, FADES, U_LOW, U_HIGH, V_LOW, V_HIGH = range(15, 28)

MAX_ALPHA, MIN_ALPHA = np.float32(op.MAX_ALPHA), np.float32(op.MIN_ALPHA)
LOG2_MAX_ALPHA, LOG2_MIN_ALPHA = np.float32(math.log2(op.MAX_ALPHA)), np.float32(math.log2(op.MIN_ALPHA))
MIN_TRANSMITTANCE = np.float32(op.MIN_TRANSMITTANCE)
MIN_DETERMINANT, EDGE_ON = np.float32(op.MIN_DETERMINANT), np.float32(op.EDGE_ON)
# sqrt(log2(e) / 2): converts distances in standard deviations to the records' base-2 exponent.
EXPONENT_SCALE = np.float32(math.sqrt(math.log2(math.e) / 2))

# Number of parts into which the Gaussians are divided for threads: enough for many threads, with negligible overhead.
CHUNKS = 64


@internal(error_model="numpy")
def tail_of(array, n):
    """The rows of a flat array of n rows after the last full block of eight, padded with zeros to eight."""
    width = array.size // n if n > 0 else 0
    padded = np.zeros(LANES * width, np.float32)
    start = n // LANES * LANES * width
    for k in range(start, n * width):
        padded[k - start] = array[k]
    return padded


@internal(error_model="numpy")
def tails_of(arrays, n):
    """The last, incomplete block of each of nine arrays, see `tail_of`."""
    return (
        tail_of(arrays[0], n), tail_of(arrays[1], n), tail_of(arrays[2], n), tail_of(arrays[3], n),
        tail_of(arrays[4], n), tail_of(arrays[5], n), tail_of(arrays[6], n), tail_of(arrays[7], n),
        tail_of(arrays[8], n),
    )  # fmt: skip
