"""The definition of Adam's step, in plain torch: any floating type, any device."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

from .op import BETA1, BETA2, whole_gradient

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


@torch.no_grad()
def adam(
    params: Sequence[Tensor], grads: Sequence[Tensor], exp_avgs: Sequence[Tensor], exp_avg_sqs: Sequence[Tensor],
    steps: Sequence[int], lrs: Sequence[float], eps: float, rows: Sequence[int], finite: bool,
    found_inf: Tensor | None,
) -> None:  # fmt: skip
    if found_inf is not None and bool(found_inf == 1):
        return
    for param, grad, exp_avg, exp_avg_sq, step, lr, row in zip(
        params, grads, exp_avgs, exp_avg_sqs, steps, lrs, rows, strict=True
    ):
        gradient = whole_gradient(param, grad, row, finite)
        exp_avg.mul_(BETA1).add_(gradient, alpha=1 - BETA1)
        exp_avg_sq.mul_(BETA2).addcmul_(gradient, gradient, value=1 - BETA2)
        root = (exp_avg_sq / (1 - BETA2**step)).sqrt()
        param.sub_(lr / (1 - BETA1**step) * exp_avg / (root + eps))
