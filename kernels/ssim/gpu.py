"""Structural similarity on a GPU: `ssim` and `l1_ssim` with their gradients, float32, Triton, one autograd function."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

from .op import K1, K2, Border, gaussian_window

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 256


@cache
def _window(window: int, sigma: float, device: torch.device) -> Tensor:
    """(window,): the weights. Kept, since making them copies to the device."""
    return torch.tensor(gaussian_window(window, sigma), dtype=torch.float32, device=device)


@cache
def _frame(size: int, window: int, sigma: float, border: Border, device: torch.device) -> tuple[Tensor, float]:
    """Along one axis: (2, size), the share of the window inside the image, and 1 where a pixel counts, else 0; and how
    many count."""
    weights = torch.tensor(gaussian_window(window, sigma), dtype=torch.float64)
    radius = window // 2
    ones = torch.ones(1, 1, size, dtype=torch.float64)
    share = torch.nn.functional.conv1d(ones, weights[None, None], padding=radius)[0, 0]
    counts = torch.ones(size, dtype=torch.float64)
    if border == "valid":
        counts[:radius] = counts[size - radius :] = 0
    return torch.stack([share, counts]).float().to(device), float(counts.sum())


@cache
def _factors(values: tuple[float, ...], device: torch.device) -> tuple[Tensor, Tensor]:
    """The values in double and in single precision; kept, as `_window`."""
    return torch.tensor(values, dtype=torch.float64, device=device), torch.tensor(values, device=device)


class _Compare(torch.autograd.Function):
    """The sum of three means, each times its share: of 1 - S, or of weight times 1 - S; of weight times |prediction -
    target|; and the error of the edges. Differentiable with respect to the prediction."""

    @staticmethod
    def forward(context, prediction, target, weight, settings, kind, shares):
        border, side, sigma, data_range = settings
        with_l1, weigh_all, with_edges = kind
        windows = kernels("ssim.gpu_windows")
        prediction, target = prediction.contiguous(), target.contiguous()
        height, width, channels = prediction.shape
        length, device = width * channels, prediction.device
        taps = _window(side, sigma, device)
        frame_y, counted_y = _frame(height, side, sigma, border, device)
        frame_x, counted_x = _frame(width, side, sigma, border, device)
        centre = 0.5 * data_range
        radius = side // 2
        constants = {
            "RADIUS": radius,
            "WEIGHTED": weight is not None,
            "WEIGH_ALL": weigh_all and weight is not None,
            "L1": with_l1,
            "EDGES": with_edges,
            "BLOCK": _BLOCK,
        }
        # A kernel without a weight never reads this place.
        weights = target if weight is None else weight.contiguous()
        grid = -(-length // _BLOCK), height
        maps = torch.empty(4, height, length, device=device)
        slopes = torch.empty(3, height, length, device=device)
        sums = torch.zeros(grid[0] * height, 4, device=device)
        launch(
            windows.filter_images_along_rows, grid, prediction, target, taps, maps, length, channels, centre,
            RADIUS=radius, BLOCK=_BLOCK,
        )  # fmt: skip
        launch(
            windows.compare, grid, prediction, target, weights, taps, frame_y, frame_x, maps, slopes, sums,
            height, length, channels, centre,
            (K1 * data_range) ** 2, (K2 * data_range) ** 2, **constants,
        )  # fmt: skip
        # Numbers in a row, and in a column, that have a neighbour behind them; never 0, since they are divided by.
        pairs = max(height * (width - 1) * channels, 1), max((height - 1) * width * channels, 1)
        counts = counted_y * counted_x * channels, prediction.numel(), *pairs
        unlike, l1, edges = shares
        # Multiplied by all at once, as every small operation has its own launch.
        exact, factors = _factors(
            tuple(share / count for share, count in zip((unlike, l1, edges, edges), counts, strict=True)), device
        )
        context.save_for_backward(prediction, target, weights, slopes, factors)
        context.call = taps, centre, constants, grid
        return (sums.sum(0, dtype=torch.float64) * exact).sum().float()

    @staticmethod
    @once_differentiable
    def backward(context, by_sum):
        windows = kernels("ssim.gpu_windows")
        prediction, target, weights, slopes, factors = context.saved_tensors
        taps, centre, kind, grid = context.call
        height, length, channels = slopes.shape[1], slopes.shape[2], prediction.shape[2]
        maps = torch.empty_like(slopes)
        launch(
            windows.filter_slopes_along_rows, grid, slopes, taps, maps, length, channels,
            RADIUS=kind["RADIUS"], BLOCK=_BLOCK,
        )  # fmt: skip
        result = torch.empty_like(prediction)
        launch(
            windows.gradient, grid, prediction, target, weights, taps, maps, by_sum * factors, result,
            height, length, channels, centre, **kind,
        )  # fmt: skip
        return result, None, None, None, None, None


def ssim(prediction, target, border, window, sigma, data_range):
    settings = border, window, sigma, data_range
    return 1 - _Compare.apply(prediction, target, None, settings, (False, False, False), (1.0, 0.0, 0.0))


def l1_ssim(prediction, target, ssim_weight, weight, weigh_all, edge_weight, border, window, sigma, data_range):
    settings, kind = (border, window, sigma, data_range), (True, weigh_all, edge_weight != 0)
    return _Compare.apply(prediction, target, weight, settings, kind, (ssim_weight, 1 - ssim_weight, edge_weight))
