"""Adam's step on the CPU: torch's fused one, float32, which reads and writes everything once."""

from __future__ import annotations

import torch
from torch.optim.adam import adam as step_of_torch

from dofbench.runtime.backend import Backend

from .op import BETA1, BETA2, whole_gradient

BACKEND = Backend(devices=("cpu",), dtypes=("float32",), bits_repeat=True)


@torch.no_grad()
def adam(params, grads, exp_avgs, exp_avg_sqs, steps, lrs, eps, rows, finite, found_inf):
    for param, grad, exp_avg, exp_avg_sq, step, lr, row in zip(
        params, grads, exp_avgs, exp_avg_sqs, steps, lrs, rows, strict=True
    ):
        gradient, before = whole_gradient(param, grad, row, finite), torch.tensor(float(step - 1))
        step_of_torch(
            [param], [gradient], [exp_avg], [exp_avg_sq], [], [before], fused=True, found_inf=found_inf,
            amsgrad=False, beta1=BETA1, beta2=BETA2, lr=lr, weight_decay=0.0, eps=eps, maximize=False,
        )  # fmt: skip
