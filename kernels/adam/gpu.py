"""Adam's step on a GPU: float32, one Triton launch for all tensors, which reads and writes everything once.

torch's fused Adam gives each of its programs 65 536 numbers, which is one program for every 1 100 Gaussians: few of a
GPU's multiprocessors work, and a step took ten times what its bytes take (docs/notes/gpu.md).
"""

from __future__ import annotations

import math

import numpy as np
import torch

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import kernels, launch

from .op import BETA1, BETA2

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024


@torch.no_grad()
def adam(params, grads, exp_avgs, exp_avg_sqs, steps, lrs, eps, rows, finite, found_inf):
    for name, tensors in (("param", params), ("exp_avg", exp_avgs), ("exp_avg_sq", exp_avg_sqs)):
        for tensor in tensors:
            if not tensor.is_contiguous():
                raise ValueError(f"adam {name}: expected a contiguous tensor, found strides {tensor.stride()}")
    grads = [grad.contiguous() for grad in grads]  # kept until the launch
    # A row for each tensor, see `gpu_step`. The driver copies so few numbers at once, so that the host doesn't wait.
    table, block = np.zeros((len(params), 8), np.int64), 0
    numbers = table.view(np.float32)
    for k, (param, grad, exp_avg, exp_avg_sq, row) in enumerate(
        zip(params, grads, exp_avgs, exp_avg_sqs, rows, strict=True)
    ):
        begin = row * param.stride(0) if row else 0
        pointers = (one.data_ptr() for one in (param, grad, exp_avg, exp_avg_sq))
        table[k, :7] = (*pointers, block, param.numel(), begin << 32 | grad.numel())
        numbers[k, 14:] = lrs[k] / (1.0 - BETA1 ** steps[k]), 1.0 / math.sqrt(1.0 - BETA2 ** steps[k])
        block += -(-param.numel() // _BLOCK)
    on_device = torch.from_numpy(table).to(params[0].device, non_blocking=True)
    launch(
        kernels("adam.gpu_step").update, (block,), on_device, on_device.view(torch.float32),
        params[0] if found_inf is None else found_inf, len(params),
        BETA1, 1.0 - BETA1, BETA2, 1.0 - BETA2, float(eps),
        FINITE=finite, WATCHED=found_inf is not None, BLOCK=_BLOCK,
    )  # fmt: skip
