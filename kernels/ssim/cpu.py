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
from torch import Tensor
from torch.autograd.function import once_differentiable

from dofbench.runtime.backend import Backend
from dofbench.runtime.kernel_cache import is_compiled

from .cpu_edges import add_edges_gradient, edges
from .cpu_windows import BAND, build
from .reference import K1, K2, Border, Settings, check_images, check_weight, gaussian_window

_NOTHING = np.empty((0, 0), dtype=np.float32)  # what the kernels take for no weight


class _Compare(torch.autograd.Function):
    """(mean of 1 - S, or of weight times 1 - S; mean of weight times |prediction - target|; error of the edges), all
    differentiable with respect to the prediction."""

    @staticmethod
    def forward(context, prediction: Tensor, target: Tensor, weight: Tensor | None, settings: Settings):
        height, width, channels = prediction.shape
        p, t = (image.detach().contiguous().view(height, width * channels).numpy() for image in (prediction, target))
        w = _NOTHING if weight is None else weight.detach().contiguous().numpy()
        window = gaussian_window(settings.window, settings.sigma)
        taps = np.asarray(window, dtype=np.float32)
        frame_y = _frame(height, window, settings.border)
        frame_x = _frame(width, window, settings.border, channels)
        # Images are shifted by this, since squares of numbers around zero lose fewer digits than those around one half.
        centre = np.float32(0.5 * settings.data_range)
        c1, c2 = (np.float32((k * settings.data_range) ** 2) for k in (K1, K2))
        maps = np.empty((3, height, width * channels), dtype=np.float32)
        sums = np.empty((-(-height // BAND), 2))
        forward, context.kernel = build(settings.window // 2, channels)
        forward(p, t, w, taps, frame_y, frame_x, centre, c1, c2, settings.with_l1, settings.weigh_all, maps, sums)
        counted = float(frame_y[1].sum(dtype=np.float64)) * float(frame_x[1].sum(dtype=np.float64))
        # Saved because torch then checks that they haven't been modified before the backward pass.
        context.save_for_backward(prediction, target, weight)
        context.call = p, t, w, taps, centre, settings.with_l1, maps
        context.counts = counted, p.size
        context.shape = prediction.shape
        unlike, l1 = sums.sum(axis=0)
        # Numbers in a row, and in a column, that have a neighbour behind them; never 0, since they are divided by.
        context.pairs = max(height * (width - 1) * channels, 1), max((height - 1) * width * channels, 1)
        context.with_edges, edge_error = settings.with_edges, 0.0
        if settings.with_edges:
            steps = np.empty((height, 2))
            context.edge_shares = w if settings.weigh_all else _NOTHING
            edges(p, t, context.edge_shares, channels, steps)
            edge_error = float((steps.sum(axis=0) / context.pairs).sum())
        return tuple(prediction.new_tensor(value) for value in (unlike / counted, l1 / p.size, edge_error))

    @staticmethod
    @once_differentiable
    def backward(context, by_unlike: Tensor, by_l1: Tensor, by_edges: Tensor):
        context.saved_tensors  # noqa: B018 (raises if one was changed in place)
        counted, size = context.counts
        gradient = np.empty_like(context.call[0])
        scale, scale_l1 = np.float32(-float(by_unlike) / counted), np.float32(float(by_l1) / size)
        context.kernel(*context.call, scale, scale_l1, gradient)
        if context.with_edges:
            p, t = context.call[:2]
            scales = (np.float32(float(by_edges) / pairs) for pairs in context.pairs)
            add_edges_gradient(p, t, context.edge_shares, context.shape[2], *scales, gradient)
        return torch.from_numpy(gradient).view(context.shape), None, None, None


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


def _check_device(*images: Tensor | None) -> None:
    for image in images:
        if image is not None and (image.dtype != torch.float32 or image.device.type != "cpu"):
            raise ValueError(f"ssim on the CPU: expected float32 on cpu, found {image.dtype} on {image.device}")


def ssim(
    prediction: Tensor,
    target: Tensor,
    *,
    border: Border = "same",
    window: int = 11,
    sigma: float = 1.5,
    data_range: float = 1.0,
) -> Tensor:
    """Mean structural similarity; see `reference.ssim`. float32 on the CPU, differentiable with respect to
    `prediction`.

    Raises ValueError for invalid arguments.
    """
    check_images(prediction, target, border, window, sigma, data_range)
    _check_device(prediction, target)
    settings = Settings(border, window, sigma, data_range, with_l1=False, weigh_all=False, with_edges=False)
    return 1 - _Compare.apply(prediction, target, None, settings)[0]


def l1_ssim(
    prediction: Tensor,
    target: Tensor,
    *,
    ssim_weight: float,
    weight: Tensor | None = None,
    weigh_all: bool = False,
    edge_weight: float = 0.0,
    border: Border = "same",
    window: int = 11,
    sigma: float = 1.5,
    data_range: float = 1.0,
) -> Tensor:
    """(1 - ssim_weight) L1 + ssim_weight (1 - SSIM) + edge_weight times the error of the edges; see
    `reference.l1_ssim`. float32 on the CPU.

    Raises ValueError for invalid arguments.
    """
    check_images(prediction, target, border, window, sigma, data_range)
    check_weight(prediction, weight)
    _check_device(prediction, target, weight)
    settings = Settings(border, window, sigma, data_range, True, weigh_all, with_edges=edge_weight != 0)
    unlike, l1, edge_error = _Compare.apply(prediction, target, weight, settings)
    loss = (1 - ssim_weight) * l1 + ssim_weight * unlike
    return loss + edge_weight * edge_error if edge_weight else loss


def _warm_up(*, ssim_weight: float = 0.2, edge_weight: float = 1.0, **options: Any) -> None:
    """Compile both functions for images of three channels; options: those of `l1_ssim`."""
    image = torch.rand((32, 32, 3), generator=torch.Generator().manual_seed(0)).requires_grad_()
    l1_ssim(image, torch.zeros_like(image), ssim_weight=ssim_weight, edge_weight=edge_weight, **options).backward()


def _is_warm() -> bool:
    _, backward = build(5, 3)  # the usual window, three channels
    return is_compiled(backward) and is_compiled(add_edges_gradient)


BACKEND = Backend(devices=("cpu",), dtypes=("float32",), bits_repeat=True, warm_up=_warm_up, is_warm=_is_warm)
