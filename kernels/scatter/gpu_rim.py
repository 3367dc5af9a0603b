"""Shared by both forms of the scatter on a GPU: a circle's soft rim, how far it is followed, an aperture's directions.

Device functions only. Lengths are pixels. Where a function says (1, 1), that is because loop counters are Python's own
numbers when kernels are interpreted, and need a tensor besides."""

from __future__ import annotations

import triton
import triton.language as tl

from dofbench.core import lens

from . import op

# Sources are followed until exp(-tail) of their full weight, as on the CPU (cpu_pack.py).
BAND_EXPONENT = tl.constexpr(12.0)
FOCUS_EXPONENT = tl.constexpr(18.0)
USUAL_CONTRAST = tl.constexpr(4.0)
BRIGHT = tl.constexpr(2.718281828459045 * 4.0)
SMALLEST_MEAN = tl.constexpr(1e-30)
AREA_EPSILON = tl.constexpr(lens.AREA_EPSILON)
STOP_OPACITY = tl.constexpr(op.STOP_OPACITY)
LOG2_E = tl.constexpr(1.4426950408889634)
# The table of factors reaches this much farther across than a image, since windows of several offsets may.
MARGIN = tl.constexpr(16)


@triton.jit
def length(dx, dy):
    """(1, 1): distance of an offset."""
    return tl.sqrt(tl.zeros((1, 1), tl.float32) + (dx * dx + dy * dy))


@triton.jit
def factor_of(factors, dx, dy, height, width):
    """The aperture's radius in direction (dx, dy) as a share of a corner's, from the table (`gpu.py`, `_factors`)."""
    return tl.load(factors + (dy + height - 1) * (2 * (width + MARGIN) + 1) + dx + width + MARGIN)


@triton.jit
def _edge(inside_by, steepness):
    """1/2 + 1/2 tanh(alpha t) of t pixels inside the rim; steepness: 2 alpha log2(e)."""
    return 1.0 / (1.0 + tl.exp2(tl.minimum(-steepness * inside_by, 126.0)))


@triton.jit
def weight_of(radius, distance, steepness, obstruction, STOPPED: tl.constexpr):
    """Weight, without the area term, of a source whose radius in the target's direction is `radius`."""
    weight = _edge(radius - distance, steepness)
    if STOPPED:
        weight = weight * (1.0 - STOP_OPACITY * _edge(obstruction * radius - distance, steepness))
    return weight


@triton.jit
def weight_and_slope(radius, factor, distance, alpha, obstruction, STOPPED: tl.constexpr):
    """The same, of a source of radius `radius` along a corner and `factor` times that in the target's direction; and
    its derivative with respect to that radius."""
    steepness = 2.0 * alpha * LOG2_E
    weight = _edge(radius * factor - distance, steepness)
    slope = 2.0 * alpha * factor * weight * (1.0 - weight)
    if STOPPED:
        stop = _edge(obstruction * radius * factor - distance, steepness)
        open_share = 1.0 - STOP_OPACITY * stop
        stop_slope = 2.0 * alpha * obstruction * factor * stop * (1.0 - stop)
        slope = slope * open_share - weight * STOP_OPACITY * stop_slope
        weight = weight * open_share
    return weight, slope


@triton.jit
def band_of(peak, brightness, pixels, stop):
    """Exponent at which a source's tail is skipped. peak: its largest magnitude. brightness: largest and mean magnitude
    of the image, and the largest radius, on the device. stop: what an obstruction adds to the exponents."""
    largest, mean, widest = tl.load(brightness), tl.load(brightness + 1), tl.load(brightness + 2)
    # Tails matter more next to a highlight, and for sharp sources where the others spread far beyond a small image.
    contrast = tl.maximum(1.0, largest / tl.maximum(mean, SMALLEST_MEAN) / USUAL_CONTRAST)
    spread = tl.maximum(1.0, widest * widest / pixels)
    common = BAND_EXPONENT + tl.log(spread) + stop
    usual = common + tl.log(tl.minimum(contrast, BRIGHT / USUAL_CONTRAST))
    return tl.where(peak > BRIGHT * mean, common + tl.log(contrast), usual)


@triton.jit
def range_of(radius, band, least, shortest, obstruction, inside, largest_radius):
    """(near, far, hole_near, hole_far), radii along a corner: at offsets whose own such radius is at most `near` a
    source has its full weight, beyond `far` none; up to `hole_near` that of the central stop, from `hole_far` on the
    stop takes nothing.

    band, least: lengths of the tails. shortest: the aperture's smallest factor. Outside of the image every offset
    has any of these; a source without a radius, or with one above the largest, has no constant weight anywhere.
    """
    soft = band / shortest
    known = inside & (radius <= largest_radius)
    near = tl.where(known, radius - soft, -float("inf"))
    hole_near = tl.where(known, obstruction * radius - soft, -float("inf"))
    # A comparison with NaN is false: such a source is met by itself alone, at distance 0.
    far = tl.where(radius >= 0.0, tl.maximum(radius + soft, least / shortest), 0.0)
    hole_far = tl.where(known, obstruction * radius + soft, float("inf"))
    return (
        tl.where(inside, near, float("inf")),
        tl.where(inside, far, -float("inf")),
        tl.where(inside, hole_near, float("inf")),
        tl.where(inside, hole_far, -float("inf")),
    )
