"""`surface`, `circle` and `known_depth` with their gradients on a GPU: float32, Triton, one autograd function each."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from dofbench.runtime.backend import Backend
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.gpu_launch import check_tensors, kernels, launch

from .reference import LEAST_SHARES, check_shapes

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024
_SAMPLES = 256  # of a program; more would need so many registers that few programs fit


def surface(depth: Tensor, alpha: Tensor, least_alpha: float) -> Tensor:
    """See `reference.surface`. float32 on a GPU; raises ValueError for another type, device or shape."""
    check_tensors("surface", depth=depth, alpha=alpha)
    check_shapes(depth, alpha)
    return _Surface.apply(depth.contiguous(), alpha.contiguous(), float(least_alpha))


def circle(
    disparity: Tensor,
    slope: Tensor | float,
    offset: Tensor | float,
    *,
    low: float,
    extent: float,
    scale: float,
    clipped: tuple[float, float] = (-math.inf, math.inf),
) -> Tensor:
    """See `reference.circle`. float32 on a GPU; raises ValueError for another type or device."""
    slope, offset = (one if isinstance(one, Tensor) else beside(disparity, one) for one in (slope, offset))
    check_tensors("surface", disparity=disparity, slope=slope, offset=offset)
    numbers = tuple(float(value) for value in (low, extent, scale, *clipped))
    return _Circle.apply(disparity.contiguous(), slope, offset, numbers)


def known_depth(
    depth: Tensor,
    alpha: Tensor,
    rows: Tensor,
    columns: Tensor,
    known: Tensor,
    shares: Tensor | None,
    weight: Tensor | None,
    *,
    most: int | None,
    least_alpha: float,
    extent: float | None,
    squared: bool,
) -> Tensor:
    """See `reference.known_depth`. float32 on a GPU.

    Raises ValueError for another type, device or shape, and where `most` isn't known: the first sample of a pixel adds
    up the gradients of the next ones, in their order. Samples must lie in the picture.
    """
    check_tensors("surface", depth=depth, alpha=alpha, known=known, shares=shares, weight=weight)
    check_shapes(depth, alpha, weight)
    if most is None:
        raise ValueError("surface: expected to be told how many samples a pixel has at most, found None")
    call = {
        "INVERSE": extent is not None,
        "SQUARED": squared,
        "SHARED": shares is not None,
        "WEIGHTED": weight is not None,
        "BLOCK": _SAMPLES,
    }
    numbers = float(least_alpha), 1.0 if extent is None else 1 / extent
    # A kernel that knows no shares, or no weight, never looks at what stands in its place.
    samples = (
        rows,
        columns,
        known,
        known if shares is None else shares,
        known if weight is None else weight.contiguous(),
    )
    return _KnownDepth.apply(depth.contiguous(), alpha.detach().contiguous(), samples, most, numbers, call)


class _Surface(torch.autograd.Function):
    @staticmethod
    def forward(context, depth, alpha, least_alpha):
        size, grid = depth.numel(), _grid(depth.numel())
        result, farthest = torch.empty_like(depth), depth.new_empty(grid)
        pixels = kernels("surface.gpu_circles")
        launch(pixels.disparities, grid, depth, alpha, result, farthest, size, least_alpha, BLOCK=_BLOCK)
        launch(pixels.fill, grid, depth, alpha, farthest, result, size, grid[0], least_alpha, BLOCK=_BLOCK)
        context.save_for_backward(depth, alpha)
        context.least_alpha = least_alpha
        return result

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        depth, alpha = context.saved_tensors
        size, result = depth.numel(), torch.empty_like(depth)
        call = gradient.contiguous(), depth, alpha, result, size, context.least_alpha
        launch(kernels("surface.gpu_circles").disparities_gradient, _grid(size), *call, BLOCK=_BLOCK)
        return result, None, None


class _Circle(torch.autograd.Function):
    @staticmethod
    def forward(context, disparity, slope, offset, numbers):
        size, result = disparity.numel(), torch.empty_like(disparity)
        call = disparity, slope, offset, result, size, *numbers
        launch(kernels("surface.gpu_circles").circles, _grid(size), *call, BLOCK=_BLOCK)
        context.save_for_backward(disparity, slope)
        context.numbers, context.offset = numbers, offset.shape
        return result

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        disparity, slope = context.saved_tensors
        size, grid = disparity.numel(), _grid(disparity.numel())
        result, sums = torch.empty_like(disparity), disparity.new_empty(*grid, 2)
        call = gradient.contiguous(), disparity, slope, result, sums, size, *context.numbers
        launch(kernels("surface.gpu_circles").circles_gradient, grid, *call, BLOCK=_BLOCK)
        by_slope, by_offset = sums.sum(0)
        return result, by_slope.view(slope.shape), by_offset.view(context.offset), None


class _KnownDepth(torch.autograd.Function):
    @staticmethod
    def forward(context, depth, alpha, samples, most, numbers, call):
        count, width = samples[2].numel(), depth.shape[1]
        grid = _grid(count, _SAMPLES)
        sums = depth.new_empty(*grid, 2)
        launch(
            kernels("surface.gpu_depth_error").depth_error, grid, depth, alpha, *samples, sums, count, width, *numbers,
            **call,
        )  # fmt: skip
        error, counted = sums.sum(0)
        counted = counted.clamp(min=LEAST_SHARES)
        context.save_for_backward(depth, alpha, counted, *samples)
        context.call = most, numbers, call
        return error / counted

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        depth, alpha, counted, *samples = context.saved_tensors
        most, numbers, call = context.call
        count, width = samples[2].numel(), depth.shape[1]
        result = torch.zeros_like(depth)
        launch(
            kernels("surface.gpu_depth_error").depth_error_gradient, _grid(count, _SAMPLES), depth, alpha, *samples,
            gradient, counted, result, count, width, most, *numbers, **call,
        )  # fmt: skip
        return result, None, None, None, None, None


def _grid(size: int, block: int = _BLOCK) -> tuple[int]:
    return (-(-size // block),)
