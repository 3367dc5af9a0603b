"""Triton kernels of the quadrature along rays: a program for each ray, a block of whose samples it reads at a time.

`counts` is (R, 2): how many of a ray's samples are looked at, since those behind them are hidden, and how many have a
colour. The numbers of the latter lie in `lit`, (S,), from the ray's first sample on, so that no program asks for the
rays before its own.
"""

from __future__ import annotations

import triton
import triton.language as tl

from . import op
from .gpu_stencil import product

LEAST_TRANSMITTANCE = tl.constexpr(op.LEAST_TRANSMITTANCE)


@triton.jit
def absorbed(optical):
    """1 - exp(-optical); by a series where the difference of numbers near 1 would lose digits."""
    series = 1.0 / 24.0 - optical * (1.0 / 120.0 - optical * (1.0 / 720.0))
    series = optical * (1.0 - optical * (1.0 / 2.0 - optical * (1.0 / 6.0 - optical * series)))
    return tl.where(optical < 0.1, series, 1.0 - tl.exp(-optical))


@triton.jit
def begin_and_end(starts, ray, size):
    """Of a ray's samples; never beyond the samples that there are, whatever `starts` holds."""
    begin = tl.maximum(tl.load(starts + ray), 0).to(tl.int32)
    return begin, tl.minimum(tl.load(starts + ray + 1), size).to(tl.int32)


@triton.jit(do_not_specialize=["size"])
def weigh(
    optical, places, starts, origins, directions, weights, behind, lit, counts, lost, results, size,
    least_weight,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """Each sample's weight, and the light that it leaves; a ray's opacity and distance, columns 3 and 4 of results.

    lost: (R,), NaN for a ray that isn't finite, else 0.
    """
    ray = tl.program_id(0)
    begin, end = begin_and_end(starts, ray, size)
    lane = tl.arange(0, BLOCK)
    before, seen_to, lit_count = tl.sum(tl.zeros((BLOCK,), tl.float32), 0), begin, 0
    opacity, distance = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    nothing = tl.zeros((BLOCK,), tl.float32)
    for first in range(begin, end, BLOCK):
        s = first + lane
        inside = s < end
        # Summed over the samples before each, not as a difference, which one dense sample would leave no digits of.
        of_last = tl.load(optical + s - 1, mask=inside & (s > begin), other=0.0)
        left = tl.exp(-(before + tl.cumsum(of_last, 0)))
        before += tl.sum(of_last, 0)
        own = tl.load(optical + s, mask=inside, other=0.0)
        # NaN isn't less, so it counts and comes out.
        seen = inside & ~(left < LEAST_TRANSMITTANCE)
        weight = tl.where(seen, left * absorbed(own), 0.0)
        place = tl.load(places + s, mask=inside, other=0.0)
        opacity += weight
        distance += weight * place
        nothing += 0.0 * place
        tl.store(weights + s, weight, mask=inside)
        tl.store(behind + s, left * tl.exp(-own), mask=inside)
        some = weight != 0.0
        seen_to = tl.maximum(seen_to, tl.max(tl.where(some, s + 1, begin), 0))
        has_colour = some & (weight >= least_weight)
        number = tl.cumsum(has_colour.to(tl.int32), 0)
        tl.store(lit + begin + lit_count + number - 1, s, mask=has_colour)
        lit_count += tl.max(number, 0)
    tl.store(counts + 2 * ray, seen_to - begin)
    tl.store(counts + 2 * ray + 1, lit_count)
    axis = tl.arange(0, 4)
    ends = 0.0 * tl.load(origins + 3 * ray + axis, mask=axis < 3, other=0.0)
    ends += 0.0 * tl.load(directions + 3 * ray + axis, mask=axis < 3, other=0.0)
    tl.store(lost + ray, tl.sum(nothing, 0) + tl.sum(ends, 0))
    tl.store(results + 5 * ray + 3, tl.sum(opacity, 0))
    tl.store(results + 5 * ray + 4, tl.sum(distance, 0))


@triton.jit
def sigmoid(x):
    """1 / (1 + exp(-x))."""
    return 1.0 / (1.0 + tl.exp(-x))


@triton.jit(do_not_specialize=["size"])
def shade(
    flat, lights, origins, directions, places, starts, counts, lit, weights, lost, colours, results, size,
    nx, ny, nz,
    RANK: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """The colours (S, 3) of samples that have one; their weighted sum in columns 0 to 2 of results.

    lights: (R, 3, 3 RANK), what a sample's channels add to the logits of red, green and blue on each ray.
    """
    ray = tl.program_id(0)
    begin, _ = begin_and_end(starts, ray, size)
    many = tl.load(counts + 2 * ray + 1)
    own_lights = lights + ray.to(tl.int64) * (9 * RANK)
    red, green, blue = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
    for first in range(0, many, BLOCK):
        k = first + tl.arange(0, BLOCK)
        inside = k < many
        s = tl.load(lit + begin + k, mask=inside, other=0)
        t = tl.load(places + s, mask=inside, other=0.0)
        x = tl.load(origins + 3 * ray) + t * tl.load(directions + 3 * ray)
        y = tl.load(origins + 3 * ray + 1) + t * tl.load(directions + 3 * ray + 1)
        z = tl.load(origins + 3 * ray + 2) + t * tl.load(directions + 3 * ray + 2)
        r, g, b = tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32), tl.zeros((BLOCK,), tl.float32)
        for mode in tl.static_range(3):
            for one in range(0, RANK, CHANNELS):
                channel = (one + tl.arange(0, CHANNELS))[None, :]
                values = product(flat, x, y, z, mode, nx, ny, nz, channel, inside, RANK)
                of_channels = own_lights + mode * RANK + channel
                r += tl.sum(values * tl.load(of_channels), 1)
                g += tl.sum(values * tl.load(of_channels + 3 * RANK), 1)
                b += tl.sum(values * tl.load(of_channels + 6 * RANK), 1)
        r, g, b = sigmoid(r), sigmoid(g), sigmoid(b)
        tl.store(colours + 3 * s, r, mask=inside)
        tl.store(colours + 3 * s + 1, g, mask=inside)
        tl.store(colours + 3 * s + 2, b, mask=inside)
        weight = tl.load(weights + s, mask=inside, other=0.0)
        red, green, blue = red + weight * r, green + weight * g, blue + weight * b
    nothing = tl.load(lost + ray)
    tl.store(results + 5 * ray, nothing + tl.sum(red, 0))
    tl.store(results + 5 * ray + 1, nothing + tl.sum(green, 0))
    tl.store(results + 5 * ray + 2, nothing + tl.sum(blue, 0))


@triton.jit
def weight_and_worth(gradient, weights, places, colours, s, inside, least_weight):
    """Samples' weights, and the gradients with respect to them. gradient: (5,), of their ray."""
    weight = tl.load(weights + s, mask=inside, other=0.0)
    worth = tl.load(gradient + 3) + tl.load(gradient + 4) * tl.load(places + s, mask=inside, other=0.0)
    # A sample without a colour has anything in its place.
    has_colour = inside & (weight != 0.0) & (weight >= least_weight)
    for channel in tl.static_range(3):
        worth += tl.load(gradient + channel) * tl.load(colours + 3 * s + channel, mask=has_colour, other=0.0)
    return weight, worth


@triton.jit(do_not_specialize=["size"])
def weigh_backward(
    gradient, starts, counts, weights, behind, slopes, places, colours, by_feature, size, least_weight,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """(S,) the gradient with respect to the sum of the density's channels, of the samples that are looked at. gradient:
    (R, 5)."""
    ray = tl.program_id(0)
    begin, _ = begin_and_end(starts, ray, size)
    many = tl.load(counts + 2 * ray)
    own = gradient + 5 * ray
    beyond = tl.sum(tl.zeros((BLOCK,), tl.float32), 0)
    blocks = tl.cdiv(many, BLOCK)
    for block in range(blocks):
        k = (blocks - 1 - block) * BLOCK + tl.arange(0, BLOCK)
        weight, worth = weight_and_worth(own, weights, places, colours, begin + k, k < many, least_weight)
        next_weight, next_worth = weight_and_worth(
            own, weights, places, colours, begin + k + 1, k + 1 < many, least_weight
        )
        # What a sample takes from all behind it; as in `weigh`, not a difference of sums.
        of_next = next_weight * next_worth
        taken = beyond + tl.cumsum(of_next, 0, reverse=True)
        beyond += tl.sum(of_next, 0)
        s = begin + k
        by_optical = tl.load(behind + s, mask=k < many, other=0.0) * worth - taken
        slope = tl.load(slopes + s, mask=k < many, other=0.0)
        tl.store(by_feature + s, tl.where(weight != 0.0, by_optical * slope, 0.0), mask=k < many)
