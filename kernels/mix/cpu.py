"""`mix` on the CPU: float32, numba. Softmax and mixing in one pass, so that the weights, hundreds a pixel, are never in
memory together.

Rows are worked on in bands of fixed height. In the backward pass each band adds to a strip of its own, which reaches
over its neighbours by half a kernel; the strips are added up in order, so the same call gives the same bits whatever
the number of threads.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, cpu_backend, internal
from dofbench.runtime.simd import LANES
from dofbench.runtime.simd_functions import exp8
from dofbench.runtime.simd_memory import load8, store8

from . import op

_BAND = 8  # rows
_FAST = {"contract", "reassoc"}  # sums may be taken in any order; NaN and infinity stay what they are


def mix(image, logits, size):
    return _Mix.apply(image, logits, size)


class _Mix(torch.autograd.Function):
    @staticmethod
    def forward(context, image, logits, size):
        padded = _padded(image.detach().numpy(), size // 2)
        flat = logits.detach().contiguous().numpy()
        mixed, largest, total = _mix(padded, flat, size)
        context.kept = padded, flat, size, mixed, largest, total
        return torch.from_numpy(mixed)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        padded, flat, size, mixed, largest, total = context.kept
        strips, by_logits = _mix_backward(padded, flat, size, mixed, largest, total, gradient.contiguous().numpy())
        by_image = _added(strips, padded.shape[1], padded.shape[2], size // 2)
        return torch.from_numpy(by_image), torch.from_numpy(by_logits), None


def _padded(image, reach):
    """(C, H + 2 reach, W + 2 reach): the channels one behind the other, zeros around."""
    return np.ascontiguousarray(np.pad(image.transpose(2, 0, 1), ((0, 0), (reach, reach), (reach, reach))))


@internal(error_model="numpy", fastmath=_FAST)
def _weights(logits, count, weights):
    """Fill `weights` (a multiple of eight numbers) with exp(logit - largest); returns the largest and the sum. A logit
    that isn't finite gives NaN."""
    largest = logits[0]
    for k in range(1, count):
        largest = max(largest, logits[k])
    for k in range(count):
        weights[k] = logits[k] - largest
    for k in range(count, weights.size):
        weights[k] = np.float32(-np.inf)
    for k in range(0, weights.size, LANES):
        store8(weights, k, exp8(load8(weights, k)))
    total = np.float32(0.0)
    for k in range(count):
        total += weights[k]
    return largest, total


@cached
@njit(parallel=PRANGE, error_model="numpy", fastmath=_FAST)
def _mix(padded, logits, size):
    channels = padded.shape[0]
    height, width, count = logits.shape
    mixed = np.empty((height, width, channels), np.float32)
    largest, total = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for band in prange((height + _BAND - 1) // _BAND):
        weights = np.empty((count + LANES - 1) // LANES * LANES, np.float32)
        for y in range(band * _BAND, min(height, (band + 1) * _BAND)):
            for x in range(width):
                most, whole = _weights(logits[y, x], count, weights)
                largest[y, x], total[y, x] = most, whole
                for c in range(channels):
                    light = np.float32(0.0)
                    for dy in range(size):
                        row, mine = padded[c, y + dy], dy * size
                        for dx in range(size):
                            light += weights[mine + dx] * row[x + dx]
                    mixed[y, x, c] = light / whole
    return mixed, largest, total


@cached
@njit(parallel=PRANGE, error_model="numpy", fastmath=_FAST)
def _mix_backward(padded, logits, size, mixed, largest, total, gradient):
    channels = padded.shape[0]
    height, width, count = logits.shape
    bands = (height + _BAND - 1) // _BAND
    strips = np.zeros((bands, channels, _BAND + size - 1, width + size - 1), np.float32)
    by_logits = np.empty_like(logits)
    for band in prange(bands):
        weights = np.empty((count + LANES - 1) // LANES * LANES, np.float32)
        first = band * _BAND
        for y in range(first, min(height, first + _BAND)):
            for x in range(width):
                _, whole = _weights(logits[y, x], count, weights)
                along = np.float32(0.0)
                for c in range(channels):
                    along += gradient[y, x, c] * mixed[y, x, c]
                mine = by_logits[y, x]
                for k in range(count):
                    weights[k] /= whole
                    mine[k] = -along
                for c in range(channels):
                    pull = gradient[y, x, c]
                    for dy in range(size):
                        row, strip, at = padded[c, y + dy], strips[band, c, y - first + dy], dy * size
                        for dx in range(size):
                            mine[at + dx] += pull * row[x + dx]
                            strip[x + dx] += pull * weights[at + dx]
                for k in range(count):
                    mine[k] *= weights[k]
    return strips, by_logits


def _added(strips, height, width, reach):
    """(H, W, C): the strips added up, from the first to the last, without what lies outside the image."""
    whole = np.zeros((strips.shape[1], height + _BAND, width), np.float32)
    for band, strip in enumerate(strips):
        whole[:, band * _BAND : band * _BAND + strip.shape[1]] += strip
    inside = whole[:, reach : height - reach, reach : width - reach]
    return np.ascontiguousarray(inside.transpose(1, 2, 0))


def _warm_up() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(4, 5, 3, generator=generator).requires_grad_()
    op.mix(image, torch.rand(4, 5, 9, generator=generator).requires_grad_()).sum().backward()


BACKEND = cpu_backend(_warm_up, _mix_backward)
