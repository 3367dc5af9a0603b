"""The definition of an optimiser's step by Adam, in plain torch: any floating type, any device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)
BETAS = (0.9, 0.999)


@dataclass(frozen=True)
class Moved:
    """One of the tensors that a step moves, with all that its movement depends on; see `adam`."""

    values: Tensor
    gradient: Tensor
    first: Tensor
    second: Tensor
    step: int
    rate: float
    row: int

    def whole_gradient(self, finite: bool) -> Tensor:
        """The gradient by all rows, 0 where none was given, and, if it is to be finite, where it isn't."""
        given = torch.nan_to_num(self.gradient, 0.0, 0.0, 0.0) if finite else self.gradient
        if given.shape == self.values.shape:
            return given
        whole = torch.zeros_like(self.values)
        whole[self.row : self.row + len(given)] = given
        return whole


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
    """A step of Adam on several tensors, in place: on each of `values`, and on the running means of its gradient, in
    `first`, and of the gradient's square, in `second`, all three of one shape (Kingma and Ba, 2015, Algorithm 1).

    The means keep shares `BETAS` of themselves. steps: the number of each tensor's step, from 1. rates: the step sizes.
    epsilon: what is added to the root of the second mean. rows: the row of `values` at which each gradient begins; a
    gradient may have fewer rows than its values, whose other rows then have a gradient of 0. None: each begins at row
    0. finite: whether what isn't finite in a gradient counts as 0. unless: a scalar on the same device; where it is 1,
    nothing is changed. The op has no gradient. Raises ValueError for sequences of different lengths and for tensors of
    different shapes.
    """
    moved = checked(values, gradients, first, second, steps, rates, rows)
    if unless is not None and bool(unless == 1):
        return
    keep, keep_squares = BETAS
    for one in moved:
        gradient = one.whole_gradient(finite)
        one.first.mul_(keep).add_(gradient, alpha=1 - keep)
        one.second.mul_(keep_squares).addcmul_(gradient, gradient, value=1 - keep_squares)
        root = (one.second / (1 - keep_squares**one.step)).sqrt()
        one.values.sub_(one.rate / (1 - keep**one.step) * one.first / (root + epsilon))


def checked(
    values: Sequence[Tensor],
    gradients: Sequence[Tensor],
    first: Sequence[Tensor],
    second: Sequence[Tensor],
    steps: Sequence[int],
    rates: Sequence[float],
    rows: Sequence[int] | None,
) -> list[Moved]:
    """The arguments of `adam` by tensor. Raises ValueError where their numbers, their shapes or a step are wrong."""
    every = (values, gradients, first, second, steps, rates, [0] * len(values) if rows is None else rows)
    if len({len(one) for one in every}) != 1:
        raise ValueError(f"adam: expected {len(values)} of each argument, found {[len(one) for one in every]}")
    moved = [Moved(*arguments) for arguments in zip(*every, strict=True)]
    for one in moved:
        _check(one)
    return moved


def _check(one: Moved) -> None:
    shape = one.values.shape
    if one.step < 1:
        raise ValueError(f"adam: expected a step of at least 1, found {one.step}")
    for name, tensor in (("first", one.first), ("second", one.second)):
        if tensor.shape != shape:
            raise ValueError(f"adam {name}: expected shape {tuple(shape)}, found {tuple(tensor.shape)}")
    if (found := one.gradient.shape) == shape and one.row == 0:
        return
    if found[1:] != shape[1:] or one.row < 0 or one.row + found[0] > shape[0]:
        whose = f"rows of {tuple(shape)} from row {one.row} on" if one.row else f"shape {tuple(shape)}"
        raise ValueError(f"adam gradient: expected {whose}, found {tuple(found)}")
