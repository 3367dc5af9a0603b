"""The tone curve on a GPU: float32, Triton."""

from __future__ import annotations

import torch

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024


def tone(values, exponent, toe, slope):
    return _Power.apply(values, float(exponent), float(toe), float(slope))


class _Power(torch.autograd.Function):
    @staticmethod
    def forward(context, values, *curve):
        values = values.contiguous()
        result, grid = torch.empty_like(values), (-(-values.numel() // _BLOCK),)
        context.save_for_backward(values, result)
        context.curve, context.grid = curve, grid
        launch(kernels("tone.gpu_power").power, grid, values, result, values.numel(), *curve, BLOCK=_BLOCK)
        return result

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        values, result = context.saved_tensors
        by_values = torch.empty_like(values)
        call = gradient.contiguous(), values, result, by_values, values.numel(), *context.curve
        launch(kernels("tone.gpu_power").power_gradient, context.grid, *call, BLOCK=_BLOCK)
        return by_values, None, None, None
