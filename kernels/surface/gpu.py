"""`surface`, `circle` and `known_depth` with their gradients on a GPU: float32, Triton, one autograd function each."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from dofbench.runtime.backend import Backend
from dofbench.runtime.device_numbers import beside
from dofbench.runtime.gpu_launch import kernels, launch

from .op import LEAST_SHARES

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024
_SAMPLES = 256  # of a program; more would need so many registers that few programs fit


def surface(depth, alpha, least_alpha):
    return _Surface.apply(depth.contiguous(), alpha.contiguous(), float(least_alpha))


def circle(disparity, slope, offset, low, extent, scale, clipped):
    slope, offset = (one if isinstance(one, Tensor) else beside(disparity, one) for one in (slope, offset))
    numbers = tuple(float(value) for value in (low, extent, scale, *clipped))
    return _Circle.apply(disparity.contiguous(), slope, offset, numbers)


def known_depth(depth, alpha, samples, weight, most, least_alpha, extent, squared):
    """The first sample of a pixel adds up the gradients of the next ones, in their order, so `most` must be given."""
    if most is None:
        raise ValueError("surface most: expected the number of samples in a pixel, found None")
    rows, columns, known, shares = samples
    call = {
        "INVERSE": extent is not None, "SQUARED": squared, "SHARED": shares is not None,
        "WEIGHTED": weight is not None, "BLOCK": _SAMPLES,
    }  # fmt: skip
    numbers = float(least_alpha), 1.0 if extent is None else 1 / extent
    # A kernel without shares, or without a weight, never reads what stands in its place.
    shares, weight = known if shares is None else shares, known if weight is None else weight.contiguous()
    samples = rows, columns, known, shares, weight
    return _KnownDepth.apply(depth.contiguous(), alpha.contiguous(), samples, most, numbers, call)


class _Surface(torch.autograd.Function):
    @staticmethod
    def forward(context, depth, alpha, least_alpha):
        size, grid = depth.numel(), _grid(depth.numel())
        result, farthest = torch.empty_like(depth), depth.new_empty(grid)
        pixels = kernels("surface.gpu_pixels")
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
        launch(kernels("surface.gpu_pixels").disparities_gradient, _grid(size), *call, BLOCK=_BLOCK)
        return result, None, None


class _Circle(torch.autograd.Function):
    @staticmethod
    def forward(context, disparity, slope, offset, numbers):
        size, result = disparity.numel(), torch.empty_like(disparity)
        call = disparity, slope, offset, result, size, *numbers
        launch(kernels("surface.gpu_pixels").circles, _grid(size), *call, BLOCK=_BLOCK)
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
        launch(kernels("surface.gpu_pixels").circles_gradient, grid, *call, BLOCK=_BLOCK)
        by_slope, by_offset = sums.sum(0)
        return result, by_slope.view(slope.shape), by_offset.view(context.offset), None


class _KnownDepth(torch.autograd.Function):
    @staticmethod
    def forward(context, depth, alpha, samples, most, numbers, call):
        count, width = samples[2].numel(), depth.shape[1]
        grid = _grid(count, _SAMPLES)
        sums = depth.new_empty(*grid, 2)
        launch(
            kernels("surface.gpu_pixels").depth_error, grid, depth, alpha, *samples, sums, count, width, *numbers,
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
            kernels("surface.gpu_pixels").depth_error_gradient, _grid(count, _SAMPLES), depth, alpha, *samples,
            gradient, counted, result, count, width, most, *numbers, **call,
        )  # fmt: skip
        return result, None, None, None, None, None


def _grid(size: int, block: int = _BLOCK) -> tuple[int]:
    return (-(-size // block),)
