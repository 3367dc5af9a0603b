"""Adam, the optimiser (Kingma and Ba, ICLR 2015, Algorithm 1), with the parameter names of `torch.optim`."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["adam"]

BETA1, BETA2 = 0.9, 0.999


def adam(
    params: Sequence[Tensor],
    grads: Sequence[Tensor],
    exp_avgs: Sequence[Tensor],
    exp_avg_sqs: Sequence[Tensor],
    *,
    steps: Sequence[int],
    lrs: Sequence[float],
    eps: float,
    rows: Sequence[int] | None = None,
    finite: bool = False,
    found_inf: Tensor | None = None,
    backend: str = AUTO,
) -> None:
    """Take one step on each of `params` in place, and update its exponential moving averages.

    exp_avgs, exp_avg_sqs: of the gradient and of its square, each of its parameter's shape, decay rates `BETA1` and
    `BETA2`. On a GPU they and params are contiguous. steps: number of each parameter's step, from 1. lrs: learning
    rates. eps: added to the root of the second average. rows: row of the parameter at which each gradient begins
    (default 0); a gradient may have fewer rows than its parameter, whose other rows have a gradient of 0. finite:
    whether gradients that aren't finite count as 0. found_inf: a scalar; where it is 1, nothing changes. Not
    differentiable. Raises ValueError for sequences of different lengths, a wrong shape, type or step.
    """
    starts = [0] * len(params) if rows is None else rows
    every = (params, grads, exp_avgs, exp_avg_sqs, steps, lrs, starts)
    if len({len(one) for one in every}) != 1:
        raise ValueError(f"adam: expected {len(params)} of each argument, found {[len(one) for one in every]}")
    for param, grad, exp_avg, exp_avg_sq, step, row in zip(
        params, grads, exp_avgs, exp_avg_sqs, steps, starts, strict=True
    ):
        shape = param.shape
        if step < 1:
            raise ValueError(f"adam: expected a step of at least 1, found {step}")
        for name, average in (("exp_avg", exp_avg), ("exp_avg_sq", exp_avg_sq)):
            if average.shape != shape:
                raise ValueError(f"adam {name}: expected shape {tuple(shape)}, found {tuple(average.shape)}")
        found, whole = grad.shape, grad.shape == shape and row == 0
        if not whole and (found[1:] != shape[1:] or row < 0 or row + found[0] > shape[0]):
            whose = f"rows of {tuple(shape)} from row {row} on" if row else f"shape {tuple(shape)}"
            raise ValueError(f"adam grad: expected {whose}, found {tuple(found)}")
        module = implementation(
            "adam", backend, param=param, grad=grad, exp_avg=exp_avg, exp_avg_sq=exp_avg_sq, found_inf=found_inf
        )
    if params:
        module.adam(params, grads, exp_avgs, exp_avg_sqs, steps, lrs, eps, starts, finite, found_inf)


def whole_gradient(param: Tensor, grad: Tensor, row: int, finite: bool) -> Tensor:
    """The gradient of all rows: 0 where none was given, and, if it is to be finite, where it isn't."""
    given = grad.nan_to_num(0.0, 0.0, 0.0) if finite else grad
    if given.shape == param.shape:
        return given
    whole = param.detach().new_zeros(param.shape)
    whole[row : row + len(given)] = given
    return whole
