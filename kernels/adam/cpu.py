"""Adam's step on the CPU: torch's fused one, float32, which reads and writes everything once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam as step_of_torch

from dofbench.runtime.backend import Backend

from .reference import BETAS, checked

BACKEND = Backend(devices=("cpu",), dtypes=("float32",), bits_repeat=True)


@torch.no_grad()
def adam(
    values: Sequence[Tensor],
    gradients: Sequence[Tensor],
    first: Sequence[Tensor],
    second: Sequence[Tensor],
    *,
    steps: Sequence[int],
    rates: Sequence[float],
    epsilon: float,
    rows: Sequence[int] | None = None,
    finite: bool = False,
    unless: Tensor | None = None,
) -> None:
    """Adam's step in place; see `reference.adam`. float32 on the CPU. Raises ValueError for other tensors."""
    keep, keep_squares = BETAS
    for one in checked(values, gradients, first, second, steps, rates, rows):
        if one.values.dtype != torch.float32 or one.values.device.type != "cpu":
            found = f"{one.values.dtype} on {one.values.device}"
            raise ValueError(f"adam on the CPU: expected float32 on cpu, found {found}")
        gradient, before = one.whole_gradient(finite), torch.tensor(float(one.step - 1))
        step_of_torch(
            [one.values], [gradient], [one.first], [one.second], [], [before], fused=True, found_inf=unless,
            amsgrad=False, beta1=keep, beta2=keep_squares, lr=one.rate, weight_decay=0.0, eps=epsilon, maximize=False,
        )  # fmt: skip
