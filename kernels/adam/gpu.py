"""Adam's step on a GPU: float32, one Triton kernel that reads and writes everything once.

torch's fused Adam gives each of its programs 65 536 numbers, which is one program for every 1 100 Gaussians: few of a
GPU's multiprocessors work, and a step took ten times what its bytes take (reports/notes/gpu.md).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dofbench.compute.backend import Backend
from dofbench.compute.gpu_launch import check_tensors, kernels, launch

from .reference import BETAS, check

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024


@torch.no_grad()
def adam(
    values: Tensor,
    gradient: Tensor,
    first: Tensor,
    second: Tensor,
    *,
    step: int,
    rate: float,
    epsilon: float,
    unless: Tensor | None = None,
) -> None:
    """Adam's step in place; see `reference.adam`. float32 on a GPU, contiguous but for the gradient.

    Raises ValueError for other tensors, InputError where Triton isn't installed.
    """
    check(values, gradient, first, second, step)
    check_tensors("adam", values=values, gradient=gradient, first=first, second=second, unless=unless)
    for name, tensor in {"values": values, "first": first, "second": second}.items():
        if not tensor.is_contiguous():
            raise ValueError(f"adam {name}: expected a contiguous tensor, found strides {tensor.stride()}")
    keep, keep_squares = BETAS
    launch(
        kernels("adam.gpu_step").update,
        (-(-values.numel() // _BLOCK),),
        values,
        gradient.contiguous(),
        first,
        second,
        values if unless is None else unless,
        values.numel(),
        keep,
        1.0 - keep,
        keep_squares,
        1.0 - keep_squares,
        rate / (1.0 - keep**step),
        1.0 / math.sqrt(1.0 - keep_squares**step),
        float(epsilon),
        WATCHED=unless is not None,
        BLOCK=_BLOCK,
    )
