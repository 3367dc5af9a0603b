"""The definition of the tone curve, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def tone(values: Tensor, exponent: float, toe: float, slope: float) -> Tensor:
    """`values ** exponent` from `toe` up, and below it the straight line through zero of this slope.

    values: any shape; negative values lie on the line, nothing is clipped at 1. exponent, toe: positive, toe in the
    units of `values`. slope: `toe ** (exponent - 1)` makes line and power meet; it is an argument so that a curve and
    its inverse can have slopes whose product is exactly 1. Differentiable with respect to `values`: the line keeps the
    slope finite at 0, where that of a power below 1 is infinite.
    """
    return torch.where(values >= toe, values.clamp_min(toe) ** exponent, values * slope)
