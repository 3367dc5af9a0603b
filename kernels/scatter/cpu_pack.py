"""The soft edge, and preparation of the direct form: padded planes of the sources, the reach of blocks of sources,
tables of the edge.

Planes are (H, PLANES, stride) float32, flattened: the edge plane, then colour and 1, both times the
area term. A row has `pad` empty pixels on either side, so that no inner loop tests for the image's border.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from dofbench.core.lens import AREA_EPSILON, ApertureShape
from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd_functions import exp2_fast8, max8, min8

from .op import COLOURS, STOP_OPACITY

BLOCK = 16  # pixels of a block: sources that share one reach, targets that are processed together
SUMS = COLOURS + 1
PLANES = COLOURS + 2
NOWHERE = np.float32(-1e9)  # reach of a block without sources

# The soft edge is followed until exp(-12) = 6e-6 of the full weight: 1.5 px at alpha = 4.
BAND_EXPONENT = 12.0
# Ratio of brightest to mean linear light in a photograph without bright highlights.
USUAL_CONTRAST = 4.0
SMALLEST_MEAN = 1e-30
# Ratio to the mean from which on a pixel counts as a highlight.
BRIGHT = math.e * USUAL_CONTRAST
# Near focus the gradient with respect to the radius comes from the tail alone, so the tail is followed to exp(-18).
FOCUS_EXPONENT = 18.0
# exp(+-80) can be multiplied by weights without overflow or underflow of float32.
LARGEST_EXPONENT = 80.0

RATIONAL, EXPONENTIAL, STOPPED = 0, 1, 2
_ONE = np.float32(1.0)
_LIMIT = np.float32(100.0)  # 1 / (1 + 2 ** +-100) is 0 or 1 in float32


@internal(error_model="numpy")
def logistic2(x):
    """1 / (1 + 2 ** x), eight lanes."""
    return _ONE / (_ONE + exp2_fast8(max8(min8(x, _LIMIT), -_LIMIT)))


@internal(error_model="numpy")
def half_width(radius, dy):
    """Half of the chord at `dy` from the centre, whole pixels; -1 where the circle doesn't reach that far."""
    rest = radius * radius - np.float32(dy) * np.float32(dy)
    return int(np.sqrt(rest)) if radius >= 0 and rest >= 0 else -1


class Geometry(NamedTuple):
    """Sizes that every kernel needs, in pixels or elements. Sources are followed to max(R + band, least).

    For sources no brighter than `bright` in any channel, `usual_band` is used instead of `band`.
    """

    height: int
    width: int
    stride: int
    pad: int
    reach_y: int
    reach_x: int
    band: float
    least: float
    usual_band: float
    bright: float


@dataclass(frozen=True)
class Edges:
    """How the weight of a source falls off at its rim, tabulated by offset.

    kind RATIONAL: 1 / (1 + outer * edge), edge = exp(-2 alpha (R - base)) a plane. Otherwise
    1 / (1 + 2 ** (outer - slope * edge)) with edge = R. Tables are (rows, 2 reach_x + 1), flattened: rows are
    target row minus source row, from 0 where `folded` (the shape is the same above and below), else
    from -reach_y; columns are source column minus target column.
    """

    kind: int
    folded: bool
    base: float
    outer: np.ndarray
    slope: np.ndarray
    stop: np.float32
    opacity: np.float32


def brightness(image: np.ndarray) -> tuple[float, float]:
    """Largest and mean magnitude of (H, W, C). The mean excludes highlights, which would hide how dark the rest is.

    Both are 1 if they can't be computed: NaN and infinity appear in the result anyway.
    """
    largest = float(max(image.max(), -image.min()))
    mean = _mean_magnitude(image, np.inf)
    if not (math.isfinite(largest) and math.isfinite(mean)):
        return 1.0, 1.0
    return largest, mean if largest <= BRIGHT * mean else _mean_magnitude(image, BRIGHT * mean)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _mean_magnitude(image, limit):
    """Mean of the magnitudes up to `limit`; 0 if there is none."""
    height, width, channels = image.shape
    sums, counts = np.zeros(height, np.float64), np.zeros(height, np.int64)
    for y in prange(height):
        for x in range(width):
            for channel in range(channels):
                magnitude = np.float64(abs(image[y, x, channel]))
                if not magnitude > limit:
                    sums[y] += magnitude
                    counts[y] += 1
    total, count = 0.0, 0
    for y in range(height):
        total += sums[y]
        count += counts[y]
    return total / max(1, count)


def geometry(
    height: int, width: int, largest: float, alpha: float, brightest: float, mean: float, stopped: bool = False
) -> Geometry:
    """Sizes for an image whose largest radius is `largest` pixels; brightest, mean: of its magnitudes, both finite.
    stopped: whether the aperture has a central stop."""
    # Tails matter more next to a highlight. They also matter more for sharp sources if most other sources spread far
    # beyond a small image, so that little of their light remains in it.
    contrast = max(1.0, brightest / max(mean, SMALLEST_MEAN) / USUAL_CONTRAST)
    spread = max(1.0, largest**2 / (height * width))
    # And they matter more where the stop takes most of what a pixel keeps to itself.
    stop = -math.log(1.0 - STOP_OPACITY) if stopped else 0.0
    usual_band, band = (
        (BAND_EXPONENT + math.log(tail) + math.log(spread) + stop) / (2.0 * alpha)
        for tail in (min(contrast, BRIGHT / USUAL_CONTRAST), contrast)
    )
    least = (FOCUS_EXPONENT + stop) / (2.0 * alpha)
    reach = math.ceil(min(max(largest + band, least), height + width))
    reach_x, reach_y = min(reach, width - 1), min(reach, height - 1)
    pad = BLOCK * (math.ceil(reach_x / BLOCK) + 1)
    stride = pad + BLOCK * math.ceil(width / BLOCK) + pad
    return Geometry(height, width, stride, pad, reach_y, reach_x, band, least, usual_band, BRIGHT * mean)


def edges(sizes: Geometry, largest: float, alpha: float, shape: ApertureShape) -> Edges:
    """Tables for this aperture; the rational form where the exponents of the whole image fit in float32."""
    folded = shape.is_disc
    rows = np.arange(0 if folded else -sizes.reach_y, sizes.reach_y + 1, dtype=np.float64)[:, None]
    columns = np.arange(-sizes.reach_x, sizes.reach_x + 1, dtype=np.float64)[None, :]
    distance = np.hypot(rows, columns)
    base = 0.5 * largest
    farthest = min(max(largest + sizes.band, sizes.least), float(distance.max()))
    if folded and 2.0 * alpha * max(base, farthest - base) <= LARGEST_EXPONENT:
        exponent = np.minimum(2.0 * alpha * (distance - base), LARGEST_EXPONENT)
        outer = np.exp(exponent).astype(np.float32).ravel()
        nothing = np.float32(0.0)
        return Edges(RATIONAL, True, base, outer, np.zeros(1, np.float32), nothing, nothing)
    factor = np.where(distance > 0, shape.radius_factor(np.arctan2(rows, -columns)), 1.0)
    scale = 2.0 * alpha * math.log2(math.e)
    stopped = shape.obstruction > 0
    return Edges(
        kind=STOPPED if stopped else EXPONENTIAL, folded=folded, base=0.0,
        outer=(scale * distance).astype(np.float32).ravel(), slope=(scale * factor).astype(np.float32).ravel(),
        stop=np.float32(shape.obstruction), opacity=np.float32(STOP_OPACITY if stopped else 0.0),
    )  # fmt: skip


@cached
@njit(parallel=PRANGE, error_model="numpy")
def pack_sources(image, signed_radius, sizes, rational, steepness, base, area):
    """Planes of the sources, flat; and for every block of a row how far its sources reach, (H, stride / BLOCK) pixels.

    image: (H, W, COLOURS). steepness: 2 alpha.
    """
    height, width, stride, pad = sizes.height, sizes.width, sizes.stride, sizes.pad
    band, least = np.float32(sizes.band), np.float32(sizes.least)
    planes = np.zeros((height, PLANES, stride), np.float32)
    reach = np.full((height, stride // BLOCK), NOWHERE, np.float32)
    for y in prange(height):
        for x in range(width):
            radius = abs(signed_radius[y, x])
            planes[y, 0, pad + x] = np.exp(-steepness * (radius - base)) if rational else radius
            share = np.float32(1.0)
            if area:
                share = np.float32(1.0) / (radius * radius + np.float32(AREA_EPSILON))
            for channel in range(COLOURS):
                planes[y, 1 + channel, pad + x] = share * image[y, x, channel]
            planes[y, PLANES - 1, pad + x] = share
        for start in range(0, width, BLOCK):
            largest = np.float32(0.0)
            for x in range(start, min(width, start + BLOCK)):
                largest = max(largest, abs(signed_radius[y, x]))
            reach[y, (pad + start) // BLOCK] = max(largest + band, least)
    return planes.reshape(-1), reach
