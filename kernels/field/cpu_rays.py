"""Rays through a factorised grid, forward and backward; a ray's samples are read eight at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.compute.kernel_cache import cached
from dofbench.compute.simd import (
    LANES,
    exp8,
    load1,
    load8,
    log2_8,
    max8,
    select8,
    splat8,
    store8,
    sums8,
)

from .cpu_stencil import ONE, ZERO, product8, product_slopes8, stencil
from .reference import LEAST_TRANSMITTANCE

RAYS_PER_TASK = 16
_STOP = np.float32(LEAST_TRANSMITTANCE)
_LN_2 = np.float32(0.6931471805599453)
_SMALL = np.float32(0.01)  # below it a series is more precise than the difference of numbers near 1
_HALF, _THIRD, _QUARTER = np.float32(1 / 2), np.float32(1 / 3), np.float32(1 / 4)
_SIXTH, _TWENTY_FOURTH = np.float32(1 / 6), np.float32(1 / 24)

# Columns of what the forward pass keeps of a sample
WEIGHT, BEHIND, SLOPE, RED, GREEN, BLUE, KEPT = 0, 1, 2, 3, 4, 5, 6


@njit(forceinline=True)
def softplus8(x):
    """(log(1 + exp(x)), its derivative)."""
    small = exp8(-max8(x, -x))
    series = small * (ONE - small * (_HALF - small * (_THIRD - small * _QUARTER)))
    excess = select8(small < _SMALL, series, log2_8(ONE + small) * _LN_2)
    value = select8(x == x, max8(x, ZERO) + excess, x)  # `max8` and `log2_8` would lose a NaN
    return value, select8(x < ZERO, small, splat8(ONE)) / (ONE + small)


@njit(forceinline=True)
def absorbed8(optical):
    """1 - exp(-optical)."""
    series = optical * (ONE - optical * (_HALF - optical * (_SIXTH - optical * _TWENTY_FOURTH)))
    return select8(optical < _SMALL, series, ONE - exp8(-optical))


@njit(forceinline=True)
def feature_lanes(flat, x, y, z, nodes, offsets, rank):
    """A point's density channels, added up into eight lanes."""
    first, second, third = stencil(x, y, z, nodes, offsets, rank)
    total = product8(flat, first, rank, 0) + product8(flat, second, rank, 0) + product8(flat, third, rank, 0)
    for channel in range(LANES, rank, LANES):
        total = total + product8(flat, first, rank, channel)
        total = total + product8(flat, second, rank, channel)
        total = total + product8(flat, third, rank, channel)
    return total


@njit(forceinline=True)
def sample_lanes(flat, origin, direction, places, s, end, nodes, offsets, rank):
    """`feature_lanes` of sample s of a ray; that of the ray's last sample for samples behind the end."""
    t = load1(places, min(s, end - 1))
    x, y, z = origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]
    return feature_lanes(flat, x, y, z, nodes, offsets, rank)


@njit(forceinline=True)
def colour_channels(flat, x, y, z, nodes, offsets, rank, channels):
    """Fill channels (3 rank) of a point."""
    first, second, third = stencil(x, y, z, nodes, offsets, rank)
    for channel in range(0, rank, LANES):
        store8(channels, channel, product8(flat, first, rank, channel))
        store8(channels, rank + channel, product8(flat, second, rank, channel))
        store8(channels, 2 * rank + channel, product8(flat, third, rank, channel))


@njit(forceinline=True)
def coefficients_of(channels, basis, coefficients):
    """Fill coefficients (P): channels (C) times basis (C, P), flat; P a multiple of eight."""
    width = coefficients.size
    for p in range(0, width, LANES):
        total = splat8(ZERO)
        for i in range(channels.size):
            total = total + load8(basis, i * width + p) * load1(channels, i)
        store8(coefficients, p, total)


@njit(forceinline=True)
def sigmoid(x):
    """1 / (1 + exp(-x)), without overflow."""
    small = np.exp(-abs(x))
    return (ONE if x >= ZERO else small) / (ONE + small)


@njit(forceinline=True)
def fill_harmonics(view, terms):
    """The spherical harmonics of `reference.harmonics`, as many as terms has room for."""
    x, y, z = view[0], view[1], view[2]
    terms[0] = np.float32(0.28209479177387814)
    if terms.size > 1:
        terms[1] = np.float32(0.4886025119029199) * y
        terms[2] = np.float32(0.4886025119029199) * z
        terms[3] = np.float32(0.4886025119029199) * x
    if terms.size > 4:
        terms[4] = np.float32(1.0925484305920792) * x * y
        terms[5] = np.float32(1.0925484305920792) * y * z
        terms[6] = np.float32(0.31539156525252005) * (np.float32(2.0) * z * z - x * x - y * y)
        terms[7] = np.float32(1.0925484305920792) * x * z
        terms[8] = np.float32(0.5462742152960396) * (x * x - y * y)


@njit(forceinline=True)
def add_harmonics_gradient(view, by_terms, by_view):
    """Add the gradient by the view direction to by_view (3)."""
    x, y, z = view[0], view[1], view[2]
    if by_terms.size > 1:
        one = np.float32(0.4886025119029199)
        by_view[0] += one * by_terms[3]
        by_view[1] += one * by_terms[1]
        by_view[2] += one * by_terms[2]
    if by_terms.size > 4:
        two, zonal = np.float32(1.0925484305920792), np.float32(0.6307831305050401)
        by_view[0] += two * (y * by_terms[4] + z * by_terms[7] + x * by_terms[8]) - zonal * x * by_terms[6]
        by_view[1] += two * (x * by_terms[4] + z * by_terms[5] - y * by_terms[8]) - zonal * y * by_terms[6]
        by_view[2] += two * (y * by_terms[5] + x * by_terms[7]) + np.float32(2.0) * zonal * z * by_terms[6]


@cached
@njit(parallel=True, error_model="numpy")
def render(grids, rays, samples, sizes, constants, kept, seen, results):
    """Render every ray; fill kept (S, KEPT), seen (R,), how many of a ray's samples count, and results (R, 5): colour,
    opacity, distance.

    grids: density, colour, basis (flat, with rows padded to a multiple of eight). rays: origins, directions, views.
    samples: starts, places, lengths. sizes: nodes, offsets and rank of the density, offsets and rank of the colour,
    harmonics. constants: shift, least weight.
    """
    density, colour, basis = grids
    origins, directions, views = rays
    starts, places, lengths = samples
    nodes, density_at, density_rank, colour_at, colour_rank, terms = sizes
    shift, least_weight = constants
    count, width = len(origins), basis.size // (3 * colour_rank)
    for task in prange(-(-count // RAYS_PER_TASK)):
        optical, absorbed = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
        slopes = np.empty(LANES, np.float32)
        channels, coefficients = np.empty(3 * colour_rank, np.float32), np.empty(width, np.float32)
        harmonic = np.empty(terms, np.float32)
        for ray in range(task * RAYS_PER_TASK, min(count, (task + 1) * RAYS_PER_TASK)):
            o, d = origins[ray], directions[ray]
            fill_harmonics(views[ray], harmonic)
            begin, end = starts[ray], starts[ray + 1]
            left, opacity, distance = ONE, ZERO, ZERO
            red, green, blue = ZERO, ZERO, ZERO
            s = begin
            while s < end and left >= _STOP:
                total = sums8(
                    sample_lanes(density, o, d, places, s, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 1, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 2, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 3, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 4, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 5, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 6, end, nodes, density_at, density_rank),
                    sample_lanes(density, o, d, places, s + 7, end, nodes, density_at, density_rank),
                )
                value, slope = softplus8(total + shift)
                for lane in range(LANES):
                    optical[lane] = lengths[min(s + lane, end - 1)]
                length = load8(optical, 0)
                store8(slopes, 0, slope * length)
                store8(absorbed, 0, absorbed8(value * length))
                block = s
                while s < min(block + LANES, end) and left >= _STOP:
                    weight = left * absorbed[s - block]
                    left -= weight
                    kept[s, WEIGHT], kept[s, BEHIND], kept[s, SLOPE] = weight, left, slopes[s - block]
                    opacity += weight
                    distance += weight * places[s]
                    if weight >= least_weight:
                        t = places[s]
                        colour_channels(
                            colour,
                            o[0] + t * d[0],
                            o[1] + t * d[1],
                            o[2] + t * d[2],
                            nodes,
                            colour_at,
                            colour_rank,
                            channels,
                        )
                        coefficients_of(channels, basis, coefficients)
                        r, g, b = ZERO, ZERO, ZERO
                        for k in range(terms):
                            r += harmonic[k] * coefficients[k]
                            g += harmonic[k] * coefficients[terms + k]
                            b += harmonic[k] * coefficients[2 * terms + k]
                        r, g, b = sigmoid(r), sigmoid(g), sigmoid(b)
                        kept[s, RED], kept[s, GREEN], kept[s, BLUE] = r, g, b
                        red, green, blue = red + weight * r, green + weight * g, blue + weight * b
                    s += 1
            seen[ray] = s - begin
            results[ray, 0], results[ray, 1], results[ray, 2] = red, green, blue
            results[ray, 3], results[ray, 4] = opacity, distance


@njit(forceinline=True)
def add_place_gradient(flat, x, y, z, nodes, offsets, rank, by_channels, step, by_point):
    """Add to by_point (3) the gradient by a point's coordinates. by_channels: by its channels, `step` numbers from mode
    to mode; with step 0 all modes have the same."""
    first, second, third = stencil(x, y, z, nodes, offsets, rank)
    by_x, by_y, by_z = splat8(ZERO), splat8(ZERO), splat8(ZERO)
    for channel in range(0, rank, LANES):
        u, v, w = product_slopes8(flat, first, rank, channel)
        g = load8(by_channels, channel)
        by_x, by_y, by_z = by_x + g * u, by_y + g * v, by_z + g * w
        u, v, w = product_slopes8(flat, second, rank, channel)
        g = load8(by_channels, step + channel)
        by_x, by_z, by_y = by_x + g * u, by_z + g * v, by_y + g * w
        u, v, w = product_slopes8(flat, third, rank, channel)
        g = load8(by_channels, 2 * step + channel)
        by_y, by_z, by_x = by_y + g * u, by_z + g * v, by_x + g * w
    none = splat8(ZERO)
    sums = sums8(by_x, by_y, by_z, none, none, none, none, none)
    store8(by_point, 0, load8(by_point, 0) + sums)


@cached
@njit(parallel=True, error_model="numpy")
def backward(grids, rays, samples, sizes, constants, kept, seen, gradient, lit_from, wanted, outputs):
    """The gradients of a rendering. gradient: (R, 5), by `render`'s results. lit_from: (R + 1,), how many samples with
    a colour lie before each ray. wanted: whether gradients by the rays are computed.

    outputs: by_feature (S,), by the sum of a sample's density channels; lit (L,), the numbers of samples with a colour;
    by_channels (L, 3 rank), by their colour channels; by_basis (tasks, like basis), to be added up; by_rays (R, 9), by
    origin, direction and view.
    """
    density, colour, basis = grids
    origins, directions, views = rays
    starts, places, _ = samples
    nodes, density_at, density_rank, colour_at, colour_rank, terms = sizes
    _, least_weight = constants
    by_feature, lit, by_channels, by_basis, by_rays = outputs
    count, depth = len(origins), 3 * colour_rank
    width = basis.size // depth
    for task in prange(-(-count // RAYS_PER_TASK)):
        channels, coefficients = np.empty(depth, np.float32), np.empty(width, np.float32)
        by_coefficients = np.zeros(width, np.float32)
        harmonic, by_terms = np.empty(terms, np.float32), np.empty(terms, np.float32)
        by_point, same = np.empty(LANES, np.float32), np.empty(density_rank, np.float32)
        by_view = np.empty(3, np.float32)
        mine = by_basis[task]
        mine[:] = ZERO
        for ray in range(task * RAYS_PER_TASK, min(count, (task + 1) * RAYS_PER_TASK)):
            o, d = origins[ray], directions[ray]
            fill_harmonics(views[ray], harmonic)
            begin, stop, end = starts[ray], starts[ray] + seen[ray], starts[ray + 1]
            red, green, blue = gradient[ray, 0], gradient[ray, 1], gradient[ray, 2]
            by_opacity, by_distance = gradient[ray, 3], gradient[ray, 4]
            by_rays[ray] = ZERO
            by_view[:] = ZERO
            by_terms[:] = ZERO
            for s in range(stop, end):
                by_feature[s] = ZERO
            behind, place = ZERO, lit_from[ray + 1]
            for s in range(stop - 1, begin - 1, -1):
                weight, t = kept[s, WEIGHT], places[s]
                x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
                by_weight = by_opacity + by_distance * t
                by_point[:] = ZERO
                if weight >= least_weight:
                    r, g, b = kept[s, RED], kept[s, GREEN], kept[s, BLUE]
                    by_weight += red * r + green * g + blue * b
                    by_r, by_g, by_b = (
                        red * weight * r * (ONE - r),
                        green * weight * g * (ONE - g),
                        blue * weight * b * (ONE - b),
                    )
                    for k in range(terms):
                        by_coefficients[k] = by_r * harmonic[k]
                        by_coefficients[terms + k] = by_g * harmonic[k]
                        by_coefficients[2 * terms + k] = by_b * harmonic[k]
                    colour_channels(colour, x, y, z, nodes, colour_at, colour_rank, channels)
                    place -= 1
                    lit[place] = s
                    row = by_channels[place]
                    for i in range(0, depth, LANES):
                        store8(row, i, times_basis8(basis, by_coefficients, i, width))
                    for i in range(depth):
                        for p in range(0, width, LANES):
                            at = i * width + p
                            store8(mine, at, load8(mine, at) + load8(by_coefficients, p) * load1(channels, i))
                    if wanted:
                        coefficients_of(channels, basis, coefficients)
                        for k in range(terms):
                            by_terms[k] += (
                                by_r * coefficients[k]
                                + by_g * coefficients[terms + k]
                                + by_b * coefficients[2 * terms + k]
                            )
                        add_place_gradient(colour, x, y, z, nodes, colour_at, colour_rank, row, colour_rank, by_point)
                by_optical = kept[s, BEHIND] * by_weight - behind
                behind += weight * by_weight
                by_feature[s] = by_optical * kept[s, SLOPE]
                if wanted:
                    same[:] = by_feature[s]
                    add_place_gradient(density, x, y, z, nodes, density_at, density_rank, same, 0, by_point)
                    for axis in range(3):
                        coordinate = o[axis] + t * d[axis]
                        if coordinate >= ZERO and coordinate <= ONE:
                            slope = by_point[axis] * np.float32(nodes[axis] - 1)
                            by_rays[ray, axis] += slope
                            by_rays[ray, 3 + axis] += slope * t
            if wanted:
                add_harmonics_gradient(views[ray], by_terms, by_view)
                for axis in range(3):
                    by_rays[ray, 6 + axis] = by_view[axis]


@njit(forceinline=True)
def times_basis8(basis, by_coefficients, i, width):
    """Rows i to i + 7 of basis times by_coefficients."""
    a, b, c, d = splat8(ZERO), splat8(ZERO), splat8(ZERO), splat8(ZERO)
    e, f, g, h = splat8(ZERO), splat8(ZERO), splat8(ZERO), splat8(ZERO)
    for p in range(0, width, LANES):
        at, by = i * width + p, load8(by_coefficients, p)
        a = a + load8(basis, at) * by
        b = b + load8(basis, at + width) * by
        c = c + load8(basis, at + 2 * width) * by
        d = d + load8(basis, at + 3 * width) * by
        e = e + load8(basis, at + 4 * width) * by
        f = f + load8(basis, at + 5 * width) * by
        g = g + load8(basis, at + 6 * width) * by
        h = h + load8(basis, at + 7 * width) * by
    return sums8(a, b, c, d, e, f, g, h)
