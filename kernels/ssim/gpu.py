"""Structural similarity on a GPU: `ssim` and `l1_ssim` with their gradients, float32, Triton, one autograd function."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import check_tensors, kernels, launch

from .reference import K1, K2, Border, Settings, check_images, check_weight, gaussian_window

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
    def forward(
        context,
        prediction: Tensor,
        target: Tensor,
        weight: Tensor | None,
        settings: Settings,
        shares: tuple[float, float, float],
    ):
        windows = kernels("ssim.gpu_windows")
        prediction, target = prediction.contiguous(), target.contiguous()
        height, width, channels = prediction.shape
        length, device = width * channels, prediction.device
        taps = _window(settings.window, settings.sigma, device)
        frame_y, counted_y = _frame(height, settings.window, settings.sigma, settings.border, device)
        frame_x, counted_x = _frame(width, settings.window, settings.sigma, settings.border, device)
        centre = 0.5 * settings.data_range
        radius = settings.window // 2
        kind = {
            "RADIUS": radius,
            "WEIGHTED": weight is not None,
            "WEIGH_ALL": settings.weigh_all and weight is not None,
            "L1": settings.with_l1,
            "EDGES": settings.with_edges,
            "BLOCK": _BLOCK,
        }
        # A kernel that knows no weight never looks at what stands in its place.
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
            (K1 * settings.data_range) ** 2, (K2 * settings.data_range) ** 2, **kind,
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
        context.call = taps, centre, kind, grid
        return (sums.sum(0, dtype=torch.float64) * exact).sum().float()

    @staticmethod
    @once_differentiable
    def backward(context, by_sum: Tensor):
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
        return result, None, None, None, None


def ssim(
    prediction: Tensor,
    target: Tensor,
    *,
    border: Border = "same",
    window: int = 11,
    sigma: float = 1.5,
    data_range: float = 1.0,
) -> Tensor:
    """Mean structural similarity; see `reference.ssim`. float32 on a GPU, differentiable with respect to `prediction`.

    Raises ValueError for invalid arguments.
    """
    check_images(prediction, target, border, window, sigma, data_range)
    check_tensors("ssim", prediction=prediction, target=target)
    settings = Settings(border, window, sigma, data_range, with_l1=False, weigh_all=False, with_edges=False)
    return 1 - _Compare.apply(prediction, target, None, settings, (1.0, 0.0, 0.0))


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
    `reference.l1_ssim`. float32 on a GPU.

    Raises ValueError for invalid arguments.
    """
    check_images(prediction, target, border, window, sigma, data_range)
    check_weight(prediction, weight)
    check_tensors("ssim", prediction=prediction, target=target, weight=weight)
    settings = Settings(border, window, sigma, data_range, True, weigh_all, with_edges=edge_weight != 0)
    shares = ssim_weight, 1 - ssim_weight, edge_weight
    return _Compare.apply(prediction, target, weight, settings, shares)
