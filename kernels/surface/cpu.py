"""`surface`, `circle` and `known_depth` with their gradients on the CPU: float32, one autograd function each."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from dofbench.runtime.kernel_cache import cpu_backend

from . import cpu_loops as compiled
from . import op
from .op import LEAST_SHARES

_NOTHING = np.empty((0, 0), dtype=np.float32)  # what the kernels take for no weight
_NO_SHARES = np.empty(0, dtype=np.float32)


def surface(depth, alpha, least_alpha):
    return _Surface.apply(depth, alpha, least_alpha)


def circle(disparity, slope, offset, low, extent, scale, clipped):
    return _Circle.apply(disparity, slope, offset, (low, extent, scale, *clipped))


def known_depth(depth, alpha, samples, weight, most, least_alpha, extent, squared):
    return _KnownDepth.apply(depth, alpha, samples, weight, (least_alpha, extent, squared))


class _Surface(torch.autograd.Function):
    @staticmethod
    def forward(context, depth, alpha, least_alpha):
        z, opacity = _flat(depth), _flat(alpha)
        result = compiled.disparities(z, opacity, np.float32(least_alpha))
        context.kept = z, opacity, np.float32(least_alpha), depth.shape
        return torch.from_numpy(result).reshape(depth.shape)

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        *call, shape = context.kept
        return torch.from_numpy(compiled.disparities_gradient(_flat(gradient), *call)).reshape(shape), None, None


class _Circle(torch.autograd.Function):
    @staticmethod
    def forward(context, disparity, slope, offset, numbers):
        q, lens = _flat(disparity), tuple(_number(value) for value in (slope, offset))
        context.kept = q, lens[0], tuple(np.float32(value) for value in numbers), disparity.shape
        context.shapes = [value.shape if isinstance(value, Tensor) else None for value in (slope, offset)]
        return torch.from_numpy(compiled.circles(q, *lens, *context.kept[2])).reshape(disparity.shape)

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        q, slope, numbers, shape = context.kept
        by_disparity, *by_lens = compiled.circles_gradient(_flat(gradient), q, slope, *numbers)
        found = [
            None if size is None else torch.from_numpy(np.full(size, by, np.float32))
            for size, by in zip(context.shapes, by_lens, strict=True)
        ]
        return torch.from_numpy(by_disparity).reshape(shape), *found, None


class _KnownDepth(torch.autograd.Function):
    @staticmethod
    def forward(context, depth, alpha, samples, weight, options):
        least_alpha, extent, squared = options
        rows, columns, known, shares = samples
        shares, weight = (
            _NO_SHARES if shares is None else _array(shares),
            _NOTHING if weight is None else _array(weight),
        )
        arrays = (_array(one) for one in (depth, alpha, rows, columns, known))
        numbers = np.float32(least_alpha), np.float32(0.0 if extent is None else 1 / extent)
        call = (*arrays, shares, weight, *numbers, squared)
        error, counted, outside = compiled.depth_error(*call)
        if outside:
            raise IndexError(f"surface: {outside:.0f} samples of known depth outside {tuple(depth.shape)} pixels")
        context.call, context.counted = call, max(counted, LEAST_SHARES)
        return torch.from_numpy(np.array(error / context.counted, np.float32))

    @staticmethod
    @once_differentiable
    def backward(context, gradient):
        by_depth = compiled.depth_error_gradient(*context.call, np.float32(_number(gradient) / context.counted))
        return torch.from_numpy(by_depth), None, None, None, None


def _number(value: Tensor | float) -> np.float32:
    return np.float32(value.detach().numpy().item() if isinstance(value, Tensor) else value)


def _array(tensor: Tensor) -> np.ndarray:
    array: np.ndarray = tensor.detach().contiguous().numpy()
    return array


def _flat(tensor: Tensor) -> np.ndarray:
    return _array(tensor).reshape(-1)


def _warm_up() -> None:
    depth, alpha = torch.ones(4, 4, requires_grad=True), torch.ones(4, 4)
    slope, at = torch.ones((), requires_grad=True), torch.arange(4, dtype=torch.int32)
    radius = op.circle(op.surface(depth, alpha, 0.1), slope, 0.0, low=0.0, extent=1.0, scale=1.0)
    samples = at, at, torch.ones(4), None, None
    error = op.known_depth(depth, alpha, *samples, most=1, least_alpha=0.1, extent=1.0, squared=False)
    (radius.sum() + error).backward()


BACKEND = cpu_backend(_warm_up, compiled.depth_error_gradient)
