"""Copies between images and a tile's scratch memory, one row of eight pixels at a time."""

from __future__ import annotations

import numpy as np

from dofbench.runtime.kernel_cache import internal
from dofbench.runtime.simd import LANES, lanes8, select8, splat8
from dofbench.runtime.simd_functions import max8, sqrt8
from dofbench.runtime.simd_memory import gather8, scatter8, store8

from . import cpu_layout as layout

ZERO = np.float32(0.0)
HALF = np.float32(0.5)
ONE = np.float32(1.0)

# Scratch memory is a row of planes of layout.TILE_HEIGHT rows of one vector. Transmittance comes first; then the
# forward pass has the sums of weight times feature, and the median with the place of its Gaussian in the list. For
# distortion it has the inverse ray length of the first Gaussian that counts, and the moments about that: the first has
# at least 1/255 of the weight, so its distance from the mean is bounded by the spread, and their difference
# A M2 - M1**2 keeps its digits. About 0 it would lose them all where the ray meets one surface.
PLANE = layout.TILE_HEIGHT * LANES
T, RED, GREEN, BLUE, DEPTH, WEIGHT, NX, NY, NZ, MEDIAN, MEDIAN_AT, FIRST, M1, M2 = (PLANE * k for k in range(14))
# In the backward pass the planes hold the gradient of each output instead (colour's in the colour planes), the
# remaining part of the pixel's loss, and for distortion the mean inverse ray length.
LEFT, G_ALPHA, G_DEPTH, G_NX, G_NY, G_NZ, G_MEDIAN, G_SPREAD, MEAN = (PLANE * k for k in (4, 5, 9, 6, 7, 8, 11, 12, 13))
SCRATCH = 12 * PLANE
SCRATCH_WITH_DISTORTION = 14 * PLANE


@internal(forceinline=True)
def get_row(image, index, stride, count):
    """`count` <= 8 pixels of a flat image; the lanes beyond are zero."""
    if count >= LANES:
        return gather8(image, index, stride)
    buffer = np.zeros(LANES, np.float32)
    for lane in range(count):
        buffer[lane] = image[index + lane * stride]
    return gather8(buffer, 0, 1)


@internal(forceinline=True)
def put_row(image, index, stride, count, value):
    """Write the first `count` <= 8 lanes to pixels of a flat image."""
    if count >= LANES:
        scatter8(image, index, stride, value)
        return
    buffer = np.empty(LANES, np.float32)
    store8(buffer, 0, value)
    for lane in range(count):
        image[index + lane * stride] = buffer[lane]


@internal(forceinline=True)
def cosines(left, y, view):
    """Cosine between the optical axis and the ray of each of eight pixels: z-depth over ray length."""
    v = (np.float32(y) + HALF - view[layout.CY]) / view[layout.FY]
    u = (lanes8() + (np.float32(left) + HALF - view[layout.CX])) / view[layout.FX]
    return ONE / sqrt8(u * u + (v * v + ONE))


@internal(error_model="numpy")
def clear_tile(scratch, left, top, view):
    """Set transmittance to 1 inside the image and 0 outside, and everything else to 0."""
    inside = lanes8() + np.float32(left) < view[layout.WIDTH]
    for k in range(PLANE, scratch.size, LANES):
        store8(scratch, k, splat8(ZERO))
    for row in range(layout.TILE_HEIGHT):
        store8(scratch, T + row * LANES, select8(inside, ONE if top + row < view[layout.HEIGHT] else ZERO, ZERO))


@internal(error_model="numpy")
def write_tile(features, scratch, left, top, view, background, images):
    """Write the images (flat) from the sums of the forward pass."""
    color, alpha, depth, median, median_at, normal, distortion, mean_inverse = images
    width, height = np.int64(view[layout.WIDTH]), np.int64(view[layout.HEIGHT])
    count = width - left
    for row in range(min(layout.TILE_HEIGHT, height - top)):
        place = row * LANES
        at = (top + row) * width + left
        rest = gather8(scratch, T + place, 1)
        put_row(color, 3 * at, 3, count, gather8(scratch, RED + place, 1) + rest * background[0])
        put_row(color, 3 * at + 1, 3, count, gather8(scratch, GREEN + place, 1) + rest * background[1])
        put_row(color, 3 * at + 2, 3, count, gather8(scratch, BLUE + place, 1) + rest * background[2])
        put_row(alpha, at, 1, count, ONE - rest)
        if len(features) > 0:
            cosine = cosines(left, top + row, view)
            weight = gather8(scratch, WEIGHT + place, 1)
            mean = gather8(scratch, DEPTH + place, 1) / weight * cosine
            put_row(depth, at, 1, count, select8(weight == ZERO, ZERO, mean))
            if len(features) > 1:
                put_row(median, at, 1, count, gather8(scratch, MEDIAN + place, 1) * cosine)
                put_row(median_at, at, 1, count, gather8(scratch, MEDIAN_AT + place, 1))
                put_row(normal, 3 * at, 3, count, gather8(scratch, NX + place, 1))
                put_row(normal, 3 * at + 1, 3, count, gather8(scratch, NY + place, 1))
                put_row(normal, 3 * at + 2, 3, count, gather8(scratch, NZ + place, 1))
                if len(features) > 2:
                    # Dividing by the pixel's cosine turns inverse ray lengths into disparities.
                    m1, m2 = gather8(scratch, M1 + place, 1), gather8(scratch, M2 + place, 1)
                    spread = max8(weight * m2 - m1 * m1, ZERO)
                    put_row(distortion, at, 1, count, spread / (cosine * cosine))
                    mean = gather8(scratch, FIRST + place, 1) + m1 / weight
                    put_row(mean_inverse, at, 1, count, select8(weight == ZERO, ZERO, mean))


@internal(error_model="numpy")
def read_tile(features, scratch, left, top, view, images, by_images):
    """Fill the planes of the backward pass from flat images. An empty gradient means that the output isn't used by the
    loss.

    The pixel's loss to first order is S = sum of weight times s over its Gaussians, plus the background's part,
    with s = colour . g_color + g_alpha' + t g_t + n . g_normal. The mean depth doesn't change when all
    weights are scaled, so its part of S vanishes and S follows from the outputs alone. Distortion is of second
    degree in the weights, so its part is twice itself; its s is g A (m - mean)**2 + g D / A, of which the
    second term is the same for every Gaussian and goes into g_alpha'.
    """
    color, alpha, depth, _, median_at, normal, distortion, mean_inverse = images
    g_color, g_alpha, g_depth, g_median, g_normal, g_distortion = by_images
    clear_tile(scratch, left, top, view)
    width, height = np.int64(view[layout.WIDTH]), np.int64(view[layout.HEIGHT])
    count = width - left
    for row in range(min(layout.TILE_HEIGHT, height - top)):
        place = row * LANES
        at = (top + row) * width + left
        covered = get_row(alpha, at, 1, count)
        total, to_alpha = splat8(ZERO), splat8(ZERO)
        if g_color.size > 0:
            for channel in range(3):
                g = get_row(g_color, 3 * at + channel, 3, count)
                store8(scratch, RED + channel * PLANE + place, g)
                total += g * get_row(color, 3 * at + channel, 3, count)
        if g_alpha.size > 0:
            to_alpha = get_row(g_alpha, at, 1, count)
            total += to_alpha * covered
        if len(features) > 0:
            cosine = cosines(left, top + row, view)
            if g_depth.size > 0:
                g = get_row(g_depth, at, 1, count)
                g = select8(covered > ZERO, g / covered, ZERO)
                store8(scratch, G_DEPTH + place, g * cosine)
                to_alpha -= g * get_row(depth, at, 1, count)
            if len(features) > 1:
                if g_median.size > 0:
                    store8(scratch, G_MEDIAN + place, get_row(g_median, at, 1, count) * cosine)
                    store8(scratch, MEDIAN_AT + place, get_row(median_at, at, 1, count))
                if g_normal.size > 0:
                    for channel in range(3):
                        g = get_row(g_normal, 3 * at + channel, 3, count)
                        store8(scratch, G_NX + channel * PLANE + place, g)
                        total += g * get_row(normal, 3 * at + channel, 3, count)
                if len(features) > 2 and g_distortion.size > 0:
                    g, spread = get_row(g_distortion, at, 1, count), get_row(distortion, at, 1, count)
                    total += g * (spread + spread)
                    to_alpha += select8(covered > ZERO, g * spread / covered, ZERO)
                    store8(scratch, G_SPREAD + place, g * covered / (cosine * cosine))
                    store8(scratch, MEAN + place, get_row(mean_inverse, at, 1, count))
        store8(scratch, G_ALPHA + place, to_alpha)
        store8(scratch, LEFT + place, total)
