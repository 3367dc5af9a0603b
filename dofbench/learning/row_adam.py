"""Adam over a small table of parameters, of which a training step needs one row, or all of them."""

from __future__ import annotations

from itertools import groupby

import torch
from torch import Tensor

from dofbench.kernels import load
from dofbench.learning.nonfinite import finite_part

_EPSILON = 1e-15


class RowAdam:
    """Parameters that start at `values` (rows, columns), which are changed (Adam: Kingma and Ba, 2015).

    dense: whether a step on one row updates all rows, the others with a gradient of zero, so that all rows' moments
    decay; else each row's moments depend on the steps on that row alone, or on all.
    """

    def __init__(self, values: Tensor, *, dense: bool = False):
        self.values = values
        self._dense = dense
        self._first, self._second = torch.zeros_like(values), torch.zeros_like(values)
        self._visits = [0] * len(values)  # on the host, which would otherwise wait for the device at every step
        self._leaf: Tensor | None = None
        self._adam = load("adam")

    def leaf(self, row: int | None) -> Tensor:
        """(columns,) parameters of a row, (rows, columns) of all for None, as a leaf tensor that collects gradients;
        kept for `step`."""
        self._leaf = (self.values if row is None else self.values[row]).clone().requires_grad_()
        return self._leaf

    @property
    def gradient(self) -> Tensor | None:
        """Gradient with respect to the last `leaf`, of its shape; None if the loss didn't depend on it."""
        return None if self._leaf is None else self._leaf.grad

    def step(self, row: int | None, rate: float) -> None:
        """One Adam step on what the last `leaf` was, a row or all for None; does nothing if it has no gradient."""
        gradient = self.gradient
        self._leaf = None
        if gradient is None:
            return
        gradient = finite_part(gradient)
        rows = range(len(self.values))
        if row is not None and self._dense:
            own, gradient = gradient, torch.zeros_like(self.values)
            gradient[row] = own
        elif row is not None:
            rows, gradient = range(row, row + 1), gradient[None]
        for number in rows:
            self._visits[number] += 1
        for visits, alike in groupby(rows, self._visits.__getitem__):
            numbers = list(alike)
            some = slice(numbers[0], numbers[-1] + 1)
            values, first, second = self.values[some], self._first[some], self._second[some]
            slope = gradient[numbers[0] - rows.start : numbers[-1] + 1 - rows.start]
            self._adam(values, slope, first, second, step=visits, rate=rate, epsilon=_EPSILON)
