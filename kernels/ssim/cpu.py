"""Structural similarity for the CPU: `ssim` and `l1_ssim` with their gradients, float32, one autograd function.

With d = prediction - target, 2ab - a^2 - b^2 = -(a - b)^2 turns both factors of SSIM into

    S = (1 - E[d]^2 / B1) (1 - var(d) / B2),   B1 = E[p]^2 + E[t]^2 + C1,   B2 = var(p) + var(t) + C2,

which needs four filtered maps (E[p], E[t], E[p^2 + t^2], E[d^2]) instead of five and, unlike the
usual form, loses no digits if prediction and target are close, as they are at the end of a training. For the same
reason the kernels (`cpu_windows.py`) sum up 1 - S.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import torch
from numba import njit, prange
from torch.autograd.function import once_differentiable

from dofbench.runtime.kernel_cache import PRANGE, cached, cpu_backend

from . import op
from .cpu_windows import BAND, build
from .op import K1, K2, Border, gaussian_window

_HALF = np.float32(0.5)
_ZERO = np.float32(0)
_NOTHING = np.empty((0, 0), dtype=np.float32)  # what the kernels take for no weight


class _Compare(torch.autograd.Function):
    """(mean of 1 - S, or of weight times 1 - S; mean of weight times |prediction - target|; error of the edges), all
    differentiable with respect to the prediction."""

    @staticmethod
    def forward(context, prediction, target, weight, settings, kind):
        border, side, sigma, data_range = settings
        with_l1, weigh_all, with_edges = kind
        height, width, channels = prediction.shape
        p, t = (image.detach().contiguous().view(height, width * channels).numpy() for image in (prediction, target))
        w = _NOTHING if weight is None else weight.detach().contiguous().numpy()
        window = gaussian_window(side, sigma)
        taps = np.asarray(window, dtype=np.float32)
        frame_y = _frame(height, window, border)
        frame_x = _frame(width, window, border, channels)
        # Images are shifted by this, since squares of numbers around zero lose fewer digits than those around one half.
        centre = np.float32(0.5 * data_range)
        c1, c2 = (np.float32((k * data_range) ** 2) for k in (K1, K2))
        maps = np.empty((3, height, width * channels), dtype=np.float32)
        sums = np.empty((-(-height // BAND), 2))
        forward, context.kernel = build(side // 2, channels)
        forward(p, t, w, taps, frame_y, frame_x, centre, c1, c2, with_l1, weigh_all, maps, sums)
        counted = float(frame_y[1].sum(dtype=np.float64)) * float(frame_x[1].sum(dtype=np.float64))
        # Saved because torch then checks that they haven't been modified before the backward pass.
        context.save_for_backward(prediction, target, weight)
        context.call = p, t, w, taps, centre, with_l1, maps
        context.counts = counted, p.size
        context.shape = prediction.shape
        unlike, l1 = sums.sum(axis=0)
        # Numbers in a row, and in a column, that have a neighbour behind them; never 0, since they are divided by.
        context.pairs = max(height * (width - 1) * channels, 1), max((height - 1) * width * channels, 1)
        context.with_edges, edge_error = with_edges, 0.0
        if with_edges:
            steps = np.empty((height, 2))
            context.edge_shares = w if weigh_all else _NOTHING
            _edges(p, t, context.edge_shares, channels, steps)
            edge_error = float((steps.sum(axis=0) / context.pairs).sum())
        return tuple(prediction.new_tensor(value) for value in (unlike / counted, l1 / p.size, edge_error))

    @staticmethod
    @once_differentiable
    def backward(context, by_unlike, by_l1, by_edges):
        context.saved_tensors  # noqa: B018 (raises if one was changed in place)
        counted, size = context.counts
        gradient = np.empty_like(context.call[0])
        scale, scale_l1 = np.float32(-float(by_unlike) / counted), np.float32(float(by_l1) / size)
        context.kernel(*context.call, scale, scale_l1, gradient)
        if context.with_edges:
            p, t = context.call[:2]
            scales = (np.float32(float(by_edges) / pairs) for pairs in context.pairs)
            _add_edges_gradient(p, t, context.edge_shares, context.shape[2], *scales, gradient)
        return torch.from_numpy(gradient).view(context.shape), None, None, None, None


@cache
def _frame(size: int, window: tuple[float, ...], border: Border, channels: int = 1) -> np.ndarray:
    """(2, size times channels) float32 along one axis: the share of the window inside the image; 1 where a pixel
    counts, else 0. Kept, as the window."""
    radius = len(window) // 2
    frame = np.ones((2, size))
    for index in {*range(min(radius, size)), *range(max(size - radius, 0), size)}:
        frame[0, index] = sum(w for k, w in enumerate(window, index - radius) if 0 <= k < size)
        frame[1, index] = border == "same"
    return np.repeat(frame.astype(np.float32), channels, axis=1)


def ssim(prediction, target, border, window, sigma, data_range):
    return 1 - _Compare.apply(prediction, target, None, (border, window, sigma, data_range), (False, False, False))[0]


def l1_ssim(
    prediction, target, ssim_weight, weight, weigh_all, edge_weight, border, window, sigma, data_range
):  # fmt: skip
    kind = True, weigh_all, edge_weight != 0
    unlike, l1, edge_error = _Compare.apply(prediction, target, weight, (border, window, sigma, data_range), kind)
    loss = (1 - ssim_weight) * l1 + ssim_weight * unlike
    return loss + edge_weight * edge_error if edge_weight else loss


@cached
@njit(error_model="numpy", parallel=PRANGE)
def _edges(p, t, weight, channels, sums):
    """Fill sums (H, 2): for each row the weighted |e(x + 1) - e(x)| of its pixels, and |e(y + 1) - e(y)| from this row
    to the next, with e = p - t.

    p, t: (H, W channels) float32. weight: (H, W), the mean of two pixels' weights counts; or empty.
    """
    height, count = p.shape
    for y in prange(height):
        across, down = 0.0, 0.0
        for j in range(count - channels):
            k = j + channels
            step = abs((p[y, k] - t[y, k]) - (p[y, j] - t[y, j]))
            if weight.size > 0:
                step *= _HALF * (weight[y, j // channels] + weight[y, k // channels])
            across += step
        if y + 1 < height:
            for j in range(count):
                step = abs((p[y + 1, j] - t[y + 1, j]) - (p[y, j] - t[y, j]))
                if weight.size > 0:
                    step *= _HALF * (weight[y, j // channels] + weight[y + 1, j // channels])
                down += step
        sums[y, 0], sums[y, 1] = across, down


@cached
@njit(error_model="numpy", parallel=PRANGE)
def _add_edges_gradient(p, t, weight, channels, scale_across, scale_down, gradient):
    """Add to gradient (H, W channels) that of scale_across times the sum in rows, and scale_down times that in columns,
    by p. The other arguments are those of `_edges`."""
    height, count = p.shape
    for y in prange(height):
        for j in range(count):
            error = p[y, j] - t[y, j]
            across, down = _ZERO, _ZERO
            if j >= channels:
                k = j - channels
                across += _slope(error, p[y, k] - t[y, k], weight, y, j // channels, y, k // channels)
            if j + channels < count:
                k = j + channels
                across += _slope(error, p[y, k] - t[y, k], weight, y, j // channels, y, k // channels)
            if y > 0:
                down += _slope(error, p[y - 1, j] - t[y - 1, j], weight, y, j // channels, y - 1, j // channels)
            if y + 1 < height:
                down += _slope(error, p[y + 1, j] - t[y + 1, j], weight, y, j // channels, y + 1, j // channels)
            gradient[y, j] += scale_across * across + scale_down * down


@njit(error_model="numpy", inline="always")
def _slope(error, other, weight, y, x, y_other, x_other):
    """The derivative of the weighted |error - other| by `error`: 0 where the two are equal."""
    step = error - other
    sign = np.float32(step > _ZERO) - np.float32(step < _ZERO)
    return sign if weight.size == 0 else sign * (_HALF * (weight[y, x] + weight[y_other, x_other]))


def _warm_up(*, ssim_weight: float = 0.2, edge_weight: float = 1.0, **options: Any) -> None:
    """Compile both functions for images of three channels; options: those of `l1_ssim`."""
    image = torch.rand((32, 32, 3), generator=torch.Generator().manual_seed(0)).requires_grad_()
    op.l1_ssim(image, torch.zeros_like(image), ssim_weight=ssim_weight, edge_weight=edge_weight, **options).backward()


_USUAL = build(5, 3)  # the usual window, three channels
BACKEND = cpu_backend(_warm_up, _USUAL[1], _add_edges_gradient)
