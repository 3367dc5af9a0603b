"""Triton kernels of `mix`: a program for a block of pixels, in turn over its K x K neighbours.

The gradient with respect to the image is gathered as well: a pixel asks each pixel around it for the weight that it
gave, so nothing is added up by atomics and bits repeat. Images are (H, W, C) with C at most 4, `CHANNELS` of them read.
"""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def mixed(
    image, logits, result, largest, total, height, width,
    SIZE: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """The mean of the neighbours; and of each pixel's weights the largest logit and the sum, for the gradient."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < height * width
    y, x = at // width, at % width
    COUNT: tl.constexpr = SIZE * SIZE
    most = tl.load(logits + at * COUNT, mask=inside, other=0.0)
    for k in range(1, COUNT):
        logit = tl.load(logits + at * COUNT + k, mask=inside, other=0.0)
        # A maximum that keeps NaN, so that a logit that isn't a number isn't lost.
        most = tl.where((logit > most) | (logit != logit), logit, most)
    weights = tl.zeros((BLOCK,), tl.float32)
    channel = tl.arange(0, 4)[None, :]
    light = tl.zeros((BLOCK, 4), tl.float32)
    for dy in range(SIZE):
        for dx in range(SIZE):
            weight = tl.exp(tl.load(logits + at * COUNT + dy * SIZE + dx, mask=inside, other=0.0) - most)
            weights += weight
            row, column = y + dy - SIZE // 2, x + dx - SIZE // 2
            there = inside & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            come = image + ((row * width + column) * CHANNELS)[:, None] + channel
            light += weight[:, None] * tl.load(come, mask=there[:, None] & (channel < CHANNELS), other=0.0)
    tl.store(largest + at, most, mask=inside)
    tl.store(total + at, weights, mask=inside)
    to = result + (at * CHANNELS)[:, None] + channel
    tl.store(to, light / weights[:, None], mask=inside[:, None] & (channel < CHANNELS))


@triton.jit
def by_logits(
    image, logits, result, largest, total, gradient, pulls, height, width,
    SIZE: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """A logit's gradient: its share times what its neighbour's colour is worth more than the mean."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < height * width
    y, x = at // width, at % width
    COUNT: tl.constexpr = SIZE * SIZE
    channel = tl.arange(0, 4)[None, :]
    own = inside[:, None] & (channel < CHANNELS)
    pull = tl.load(gradient + (at * CHANNELS)[:, None] + channel, mask=own, other=0.0)
    along = tl.sum(pull * tl.load(result + (at * CHANNELS)[:, None] + channel, mask=own, other=0.0), 1)
    most = tl.load(largest + at, mask=inside, other=0.0)
    whole = tl.load(total + at, mask=inside, other=1.0)
    for dy in range(SIZE):
        for dx in range(SIZE):
            k = dy * SIZE + dx
            share = tl.exp(tl.load(logits + at * COUNT + k, mask=inside, other=0.0) - most) / whole
            row, column = y + dy - SIZE // 2, x + dx - SIZE // 2
            there = inside & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            come = image + ((row * width + column) * CHANNELS)[:, None] + channel
            worth = tl.sum(pull * tl.load(come, mask=there[:, None] & (channel < CHANNELS), other=0.0), 1)
            tl.store(pulls + at * COUNT + k, share * (worth - along), mask=inside)


@triton.jit
def by_image(
    logits, largest, total, gradient, pulls, height, width,
    SIZE: tl.constexpr, CHANNELS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """A pixel's gradient, from all pixels that it was mixed into."""
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < height * width
    y, x = at // width, at % width
    COUNT: tl.constexpr = SIZE * SIZE
    channel = tl.arange(0, 4)[None, :]
    light = tl.zeros((BLOCK, 4), tl.float32)
    for dy in range(SIZE):
        for dx in range(SIZE):
            row, column = y - dy + SIZE // 2, x - dx + SIZE // 2
            there = inside & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            other = row * width + column
            logit = tl.load(logits + other * COUNT + dy * SIZE + dx, mask=there, other=0.0)
            most = tl.load(largest + other, mask=there, other=0.0)
            share = tl.exp(logit - most) / tl.load(total + other, mask=there, other=1.0)
            come = gradient + (other * CHANNELS)[:, None] + channel
            light += share[:, None] * tl.load(come, mask=there[:, None] & (channel < CHANNELS), other=0.0)
    tl.store(pulls + (at * CHANNELS)[:, None] + channel, light, mask=inside[:, None] & (channel < CHANNELS))
