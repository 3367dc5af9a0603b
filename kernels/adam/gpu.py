"""Adam's step on a GPU: float32, one Triton kernel that reads and writes everything once.

torch's fused Adam gives each of its programs 65 536 numbers, which is one program for every 1 100 Gaussians: few of a
GPU's multiprocessors work, and a step took ten times what its bytes take (docs/notes/gpu.md). And one launch moves
all parameters of the Gaussians, since it is the host that a training step waits for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend
from dofbench.runtime.gpu_launch import check_tensors, kernels, launch

from .reference import BETAS, Moved, checked

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_BLOCK = 1024
_TOGETHER = 6  # tensors of a launch, as many as the kernel has places: those of Gaussians


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
    """Adam's step in place; see `reference.adam`. float32 on a GPU, contiguous but for the gradients.

    Raises ValueError for other tensors, InputError where Triton isn't installed.
    """
    moved = checked(values, gradients, first, second, steps, rates, rows)
    for one in moved:
        own = {"values": one.values, "first": one.first, "second": one.second}
        check_tensors("adam", **own, gradient=one.gradient, unless=unless)
        for name, tensor in own.items():
            if not tensor.is_contiguous():
                raise ValueError(f"adam {name}: expected a contiguous tensor, found strides {tensor.stride()}")
    for start in range(0, len(moved), _TOGETHER):
        _launch(moved[start : start + _TOGETHER], epsilon, finite, unless)


def _launch(moved: list[Moved], epsilon: float, finite: bool, unless: Tensor | None) -> None:
    """Move as many tensors as one launch can."""
    keep, keep_squares = BETAS
    arguments = [argument for one in moved for argument in _arguments(one)]
    nothing = [*arguments[:4], 0, 0, 0, 0.0, 0.0]
    launch(
        kernels("adam.gpu_step").update,
        (sum(-(-one.values.numel() // _BLOCK) for one in moved),),
        *arguments,
        *(nothing * (_TOGETHER - len(moved))),
        moved[0].values if unless is None else unless,
        keep,
        1.0 - keep,
        keep_squares,
        1.0 - keep_squares,
        float(epsilon),
        FINITE=finite,
        WATCHED=unless is not None,
        BLOCK=_BLOCK,
    )


def _arguments(one: Moved) -> tuple[Tensor, Tensor, Tensor, Tensor, int, int, int, float, float]:
    """Those of the kernel that are a tensor's own."""
    keep, keep_squares = BETAS
    begin = one.row * one.values.stride(0) if one.row else 0
    return (
        one.values,
        one.gradient.contiguous(),
        one.first,
        one.second,
        one.values.numel(),
        begin,
        one.gradient.numel(),
        one.rate / (1.0 - keep**one.step),
        1.0 / math.sqrt(1.0 - keep_squares**one.step),
    )
