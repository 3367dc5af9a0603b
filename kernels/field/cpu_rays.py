"""Rays through a factorised grid, forward and backward; a ray's samples are read eight at a time."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, internal
from dofbench.runtime.simd import LANES, select8, splat8, sums8
from dofbench.runtime.simd_functions import exp8, log2_8, max8
from dofbench.runtime.simd_memory import load1, load8, store8

from .cpu_stencil import ONE, ZERO, product8, product_slopes8, stencil
from .op import LEAST_TRANSMITTANCE

RAYS_PER_TASK = 16
_STOP = np.float32(LEAST_TRANSMITTANCE)
_LN_2 = np.float32(0.6931471805599453)
_SMALL = np.float32(0.01)  # below it a series is more precise than the difference of numbers near 1
_HALF, _THIRD, _QUARTER = np.float32(1 / 2), np.float32(1 / 3), np.float32(1 / 4)
_SIXTH, _TWENTY_FOURTH = np.float32(1 / 6), np.float32(1 / 24)

# Columns of what the forward pass keeps of a sample
WEIGHT, BEHIND, SLOPE, RED, GREEN, BLUE, KEPT = 0, 1, 2, 3, 4, 5, 6


@internal(forceinline=True)
def softplus8(x):
    """(log(1 + exp(x)), its derivative)."""
    small = exp8(-max8(x, -x))
    series = small * (ONE - small * (_HALF - small * (_THIRD - small * _QUARTER)))
    excess = select8(small < _SMALL, series, log2_8(ONE + small) * _LN_2)
    value = select8(x == x, max8(x, ZERO) + excess, x)  # `max8` and `log2_8` would lose a NaN
    return value, select8(x < ZERO, small, splat8(ONE)) / (ONE + small)


@internal(forceinline=True)
def absorbed8(optical):
    """(1 - exp(-optical), exp(-optical))."""
    passed = exp8(-optical)
    series = optical * (ONE - optical * (_HALF - optical * (_SIXTH - optical * _TWENTY_FOURTH)))
    return select8(optical < _SMALL, series, ONE - passed), passed


@internal(forceinline=True)
def feature_lanes(flat, x, y, z, nodes, offsets, rank):
    """A point's density channels, added up into eight lanes."""
    first, second, third = stencil(x, y, z, nodes, offsets, rank)
    total = product8(flat, first, rank, 0) + product8(flat, second, rank, 0) + product8(flat, third, rank, 0)
    for channel in range(LANES, rank, LANES):
        total = total + product8(flat, first, rank, channel)
        total = total + product8(flat, second, rank, channel)
        total = total + product8(flat, third, rank, channel)
    return total


@internal(forceinline=True)
def sample_lanes(flat, origin, direction, places, s, end, nodes, offsets, rank):
    """`feature_lanes` of sample s of a ray; that of the ray's last sample for samples behind the end."""
    t = load1(places, min(s, end - 1))
    x, y, z = origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]
    return feature_lanes(flat, x, y, z, nodes, offsets, rank)


@internal(forceinline=True)
def fill_colour_weights(basis, harmonic, weights):
    """Fill weights (3, C), flat: what each colour channel counts for red, green and blue, seen from a ray's direction.

    All samples of a ray share them, so that a sample costs 3 C products instead of 3 C for every harmonic.
    """
    depth, terms = weights.size // 3, harmonic.size
    for colour in range(3):
        for i in range(0, depth, LANES):
            total = splat8(ZERO)
            for k in range(terms):
                total = total + load8(basis, (colour * terms + k) * depth + i) * harmonic[k]
            store8(weights, colour * depth + i, total)


@internal(forceinline=True)
def colour_lanes(flat, x, y, z, nodes, offsets, rank, weights):
    """A point's red, green and blue before the sigmoid, each to be added up from eight lanes."""
    modes = stencil(x, y, z, nodes, offsets, rank)
    red, green, blue = splat8(ZERO), splat8(ZERO), splat8(ZERO)
    for channel in range(0, rank, LANES):
        for number, mode in enumerate(modes):
            at, value = number * rank + channel, product8(flat, mode, rank, channel)
            red = red + value * load8(weights, at)
            green = green + value * load8(weights, 3 * rank + at)
            blue = blue + value * load8(weights, 6 * rank + at)
    return red, green, blue


@internal(forceinline=True)
def add_colour_gradient(flat, x, y, z, nodes, offsets, rank, weights, by_rgb, by_channels, by_weights):
    """Fill by_channels (3 rank) with the gradient with respect to a point's channels, and add that by the weights to
    by_weights. by_rgb: the gradients with respect to red, green and blue before the sigmoid."""
    modes = stencil(x, y, z, nodes, offsets, rank)
    by_red, by_green, by_blue = by_rgb
    for channel in range(0, rank, LANES):
        for number, mode in enumerate(modes):
            red, value = number * rank + channel, product8(flat, mode, rank, channel)
            green, blue = 3 * rank + red, 6 * rank + red
            by_channel = load8(weights, red) * by_red + load8(weights, green) * by_green
            store8(by_channels, red, by_channel + load8(weights, blue) * by_blue)
            store8(by_weights, red, load8(by_weights, red) + value * by_red)
            store8(by_weights, green, load8(by_weights, green) + value * by_green)
            store8(by_weights, blue, load8(by_weights, blue) + value * by_blue)


@internal(forceinline=True)
def add_basis_gradient(basis, harmonic, by_weights, by_basis, by_terms, lanes):
    """Add to by_basis what a ray's by_weights (3, C) make of it, and fill by_terms with the gradient with respect to
    its harmonics. lanes: eight numbers, scratch."""
    depth, terms, none = by_weights.size // 3, harmonic.size, splat8(ZERO)
    for k in range(terms):
        total = splat8(ZERO)
        for colour in range(3):
            row = (colour * terms + k) * depth
            for i in range(0, depth, LANES):
                value = load8(by_weights, colour * depth + i)
                store8(by_basis, row + i, load8(by_basis, row + i) + value * harmonic[k])
                total = total + value * load8(basis, row + i)
        store8(lanes, 0, sums8(total, none, none, none, none, none, none, none))
        by_terms[k] = lanes[0]


@internal(forceinline=True)
def sigmoid(x):
    """1 / (1 + exp(-x)), without overflow."""
    small = np.exp(-abs(x))
    return (ONE if x >= ZERO else small) / (ONE + small)


@internal(forceinline=True)
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


@internal(forceinline=True)
def add_harmonics_gradient(view, by_terms, by_view):
    """Add the gradient with respect to the view direction to by_view (3)."""
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
@njit(parallel=PRANGE, error_model="numpy")
def render(grids, rays, samples, sizes, constants, kept, seen, results):
    """Render every ray; fill kept (S, KEPT), seen (R,), how many of a ray's samples count, and results (R, 5): colour,
    opacity, distance.

    grids: density, colour, basis (flat, a row of colour channels for each coefficient). rays: origins, directions,
    views. samples: starts, places, lengths. sizes: nodes, offsets and rank of the density, offsets and rank of the
    colour, harmonics. constants: shift, least weight.
    """
    density, colour, basis = grids
    origins, directions, views = rays
    starts, places, lengths = samples
    nodes, density_at, density_rank, colour_at, colour_rank, terms = sizes
    shift, least_weight = constants
    count, none = len(origins), splat8(ZERO)
    for task in prange(-(-count // RAYS_PER_TASK)):
        optical, absorbed = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
        passed = np.empty(LANES, np.float32)
        slopes = np.empty(LANES, np.float32)
        harmonic, weights = np.empty(terms, np.float32), np.empty(9 * colour_rank, np.float32)
        rgb = np.empty(LANES, np.float32)
        for ray in range(task * RAYS_PER_TASK, min(count, (task + 1) * RAYS_PER_TASK)):
            o, d = origins[ray], directions[ray]
            fill_harmonics(views[ray], harmonic)
            fill_colour_weights(basis, harmonic, weights)
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
                held_back, let_through = absorbed8(value * length)
                store8(absorbed, 0, held_back)
                store8(passed, 0, let_through)
                block = s
                while s < min(block + LANES, end) and left >= _STOP:
                    weight = left * absorbed[s - block]
                    # Multiplied, since 1 less what was held back has no digits left in an opaque ray.
                    left *= passed[s - block]
                    kept[s, WEIGHT], kept[s, BEHIND], kept[s, SLOPE] = weight, left, slopes[s - block]
                    opacity += weight
                    distance += weight * places[s]
                    if weight >= least_weight:
                        t = places[s]
                        x, y, z = o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]
                        r8, g8, b8 = colour_lanes(colour, x, y, z, nodes, colour_at, colour_rank, weights)
                        store8(rgb, 0, sums8(r8, g8, b8, none, none, none, none, none))
                        r, g, b = sigmoid(rgb[0]), sigmoid(rgb[1]), sigmoid(rgb[2])
                        kept[s, RED], kept[s, GREEN], kept[s, BLUE] = r, g, b
                        red, green, blue = red + weight * r, green + weight * g, blue + weight * b
                    s += 1
            seen[ray] = s - begin
            results[ray, 0], results[ray, 1], results[ray, 2] = red, green, blue
            results[ray, 3], results[ray, 4] = opacity, distance


@internal(forceinline=True)
def add_place_gradient(flat, x, y, z, nodes, offsets, rank, by_channels, step, by_point):
    """Add to by_point (3) the gradient with respect to a point's coordinates. by_channels: by its channels, `step`
    numbers from mode to mode; with step 0 all modes have the same."""
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
@njit(parallel=PRANGE, error_model="numpy")
def backward(grids, rays, samples, sizes, constants, kept, seen, gradient, lit_from, wanted, outputs):
    """The gradients of a rendering. gradient: (R, 5), by `render`'s results. lit_from: (R + 1,), how many samples with
    a colour lie before each ray. wanted: whether gradients with respect to the rays are computed.

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
    for task in prange(-(-count // RAYS_PER_TASK)):
        weights, by_weights = np.empty(3 * depth, np.float32), np.empty(3 * depth, np.float32)
        harmonic, by_terms = np.empty(terms, np.float32), np.empty(terms, np.float32)
        by_point, same = np.empty(LANES, np.float32), np.empty(density_rank, np.float32)
        mine = by_basis[task]
        mine[:] = ZERO
        for ray in range(task * RAYS_PER_TASK, min(count, (task + 1) * RAYS_PER_TASK)):
            o, d = origins[ray], directions[ray]
            fill_harmonics(views[ray], harmonic)
            begin, stop, end = starts[ray], starts[ray] + seen[ray], starts[ray + 1]
            red, green, blue = gradient[ray, 0], gradient[ray, 1], gradient[ray, 2]
            by_opacity, by_distance = gradient[ray, 3], gradient[ray, 4]
            by_rays[ray] = ZERO
            if lit_from[ray + 1] > lit_from[ray]:
                fill_colour_weights(basis, harmonic, weights)
                by_weights[:] = ZERO
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
                    place -= 1
                    lit[place] = s
                    row = by_channels[place]
                    add_colour_gradient(
                        colour, x, y, z, nodes, colour_at, colour_rank, weights, (by_r, by_g, by_b), row, by_weights
                    )
                    if wanted:
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
            if lit_from[ray + 1] > lit_from[ray]:
                add_basis_gradient(basis, harmonic, by_weights, mine, by_terms, by_point)
                if wanted:
                    add_harmonics_gradient(views[ray], by_terms, by_rays[ray, 6:])
