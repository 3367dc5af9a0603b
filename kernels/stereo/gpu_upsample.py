"""Triton kernel that mixes the scores of a coarser level into those of a finer one."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def _between(index, size, coarse_size):
    """(whole, share): an element's position on the coarser axis, where the first and the last element of both coincide.

    Whole numbers until the end, so that no position is rounded across an element.
    """
    steps = tl.maximum(size - 1, 1)
    position = index * (coarse_size - 1)
    whole = position // steps
    return whole, (position - whole * steps).to(tl.float32) / steps.to(tl.float32)


@triton.jit
def _within(pixel, size, coarse_size):
    """(first, second, share): the coarser pixels whose centres lie around a pixel's centre; pixels are areas."""
    position = tl.maximum((2 * pixel + 1) * coarse_size - size, 0)  # in units of 1 / (2 size)
    first = position // (2 * size)
    share = (position - first * 2 * size).to(tl.float32) / (2 * size).to(tl.float32)
    return first, tl.minimum(first + 1, coarse_size - 1), share


@triton.jit
def _mixed(one, other, share):
    return one + share * (other - one)


@triton.jit
def add_coarse(
    scores, coarse, share, height, width, plane_count, coarse_height, coarse_width, coarse_count, BLOCK: tl.constexpr
):
    """Mix coarse (h, w, d), enlarged, into scores (H, W, D) in place. Programs: blocks of a row's scores, rows."""
    row = tl.program_id(1)
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = at < width * plane_count
    column, plane = at // plane_count, at % plane_count
    nearer, deep = _between(plane, plane_count, coarse_count)
    farther = tl.minimum(nearer + 1, coarse_count - 1)
    left, right, along = _within(column, width, coarse_width)
    top, bottom, down = _within(row, height, coarse_height)
    pitch = (coarse_width * coarse_count).to(tl.int64)
    upper, lower = coarse + top * pitch, coarse + bottom * pitch
    left, right = left * coarse_count, right * coarse_count
    near = _mixed(
        _mixed(tl.load(upper + left + nearer, mask=inside), tl.load(upper + right + nearer, mask=inside), along),
        _mixed(tl.load(lower + left + nearer, mask=inside), tl.load(lower + right + nearer, mask=inside), along),
        down,
    )
    far = _mixed(
        _mixed(tl.load(upper + left + farther, mask=inside), tl.load(upper + right + farther, mask=inside), along),
        _mixed(tl.load(lower + left + farther, mask=inside), tl.load(lower + right + farther, mask=inside), along),
        down,
    )
    to = scores + row.to(tl.int64) * (width * plane_count) + at
    tl.store(to, _mixed(tl.load(to, mask=inside), _mixed(near, far, deep), share), mask=inside)
