"""The definition of an optimiser's step by Adam, in plain torch: any floating type, any device."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.compute.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)
BETAS = (0.9, 0.999)


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
    """Adam's step number `step`, from 1, in place: on `values`, and on the running means of the gradient, `first`, and
    of its square, `second`, all of one shape (Kingma and Ba, 2015, Algorithm 1).

    The means keep shares `BETAS` of themselves. rate: the step size. epsilon: what is added to the root of the second
    mean. unless: a scalar on the same device; where it is 1, nothing is changed. It has no gradient. Raises ValueError
    for tensors of different shapes.
    """
    check(values, gradient, first, second, step)
    if unless is not None and bool(unless == 1):
        return
    keep, keep_squares = BETAS
    first.mul_(keep).add_(gradient, alpha=1 - keep)
    second.mul_(keep_squares).addcmul_(gradient, gradient, value=1 - keep_squares)
    root = (second / (1 - keep_squares**step)).sqrt()
    values.sub_(rate / (1 - keep**step) * first / (root + epsilon))


def check(values: Tensor, gradient: Tensor, first: Tensor, second: Tensor, step: int) -> None:
    """Raise ValueError for a step below 1, and for tensors of different shapes."""
    if step < 1:
        raise ValueError(f"adam: expected a step of at least 1, found {step}")
    for name, tensor in {"gradient": gradient, "first": first, "second": second}.items():
        if tensor.shape != values.shape:
            raise ValueError(f"adam {name}: expected shape {tuple(values.shape)}, found {tuple(tensor.shape)}")
