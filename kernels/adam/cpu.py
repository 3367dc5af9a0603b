"""Adam's step on the CPU: torch's fused one, float32, which reads and writes everything once."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.optim.adam import adam as step_of_torch

from dofbench.compute.backend import Backend

from .reference import BETAS, check

BACKEND = Backend(devices=("cpu",), dtypes=("float32",), bits_repeat=True)


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
    """Adam's step in place; see `reference.adam`. float32 on the CPU. Raises ValueError for other tensors."""
    check(values, gradient, first, second, step)
    if values.dtype != torch.float32 or values.device.type != "cpu":
        raise ValueError(f"adam on the CPU: expected float32 on cpu, found {values.dtype} on {values.device}")
    keep, keep_squares = BETAS
    step_of_torch(
        [values], [gradient], [first], [second], [], [torch.tensor(float(step - 1))],
        fused=True, found_inf=unless, amsgrad=False, beta1=keep, beta2=keep_squares, lr=rate, weight_decay=0.0,
        eps=epsilon, maximize=False,
    )  # fmt: skip
