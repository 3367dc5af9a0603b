"""The tone curve on a GPU: float32, Triton."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import check_tensors, kernels, launch

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024


def tone(values: Tensor, exponent: float, toe: float, slope: float) -> Tensor:
    """`values ** exponent` with a linear toe; see `reference.tone`. float32 on a GPU; infinity and NaN are passed
    through.

    Raises ValueError for another type or device, InputError where Triton isn't installed.
    """
    check_tensors("tone", values=values)
    return _Power.apply(values, exponent, toe, slope)


class _Power(torch.autograd.Function):
    @staticmethod
    def forward(context, values, exponent, toe, slope):
        values = values.contiguous()
        result = torch.empty_like(values)
        context.curve = float(exponent), float(toe), float(slope)
        context.save_for_backward(values, result)
        grid = (-(-values.numel() // _BLOCK),)
        launch(kernels("tone.gpu_power").power, grid, values, result, values.numel(), *context.curve, BLOCK=_BLOCK)
        return result

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        values, result = context.saved_tensors
        gradient, by_values = gradient.contiguous(), torch.empty_like(values)
        launch(
            kernels("tone.gpu_power").power_gradient,
            (-(-values.numel() // _BLOCK),),
            gradient,
            values,
            result,
            by_values,
            values.numel(),
            *context.curve,
            BLOCK=_BLOCK,
        )
        return by_values, None, None, None
