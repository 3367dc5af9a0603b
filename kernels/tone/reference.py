"""The definition of the tone curve, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def tone(values: Tensor, exponent: float, toe: float, slope: float) -> Tensor:
    return torch.where(values >= toe, values.clamp_min(toe) ** exponent, values * slope)
