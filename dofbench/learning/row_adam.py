"""Adam over a small table of parameters, of which each training step needs one row."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.kernels import load
from dofbench.learning.nonfinite import finite_part

_EPSILON = 1e-15


class RowAdam:
    """Parameters that start at `values` (rows, columns), which are changed (Adam: Kingma and Ba, 2015).

    dense: whether every step updates all rows, with a gradient of zero but for its own row, so that all rows' moments
    decay; else each row's moments depend on the steps on that row alone.
    """

    def __init__(self, values: Tensor, *, dense: bool = False):
        self.values = values
        self._dense = dense
        self._first, self._second = torch.zeros_like(values), torch.zeros_like(values)
        self._visits = [0] * len(values)  # on the host, which would otherwise wait for the device at every step
        self._leaf: Tensor | None = None
        self._adam = load("adam")

    def leaf(self, row: int) -> Tensor:
        """(columns,) parameters of a row as a leaf tensor that collects gradients; kept for `step`."""
        self._leaf = self.values[row].clone().requires_grad_()
        return self._leaf

    @property
    def gradient(self) -> Tensor | None:
        """(columns,) gradient with respect to the row of the last `leaf`; None if the loss didn't depend on it."""
        return None if self._leaf is None else self._leaf.grad

    def step(self, row: int, rate: float) -> None:
        """One Adam step; does nothing if the row has no gradient."""
        gradient = self.gradient
        self._leaf = None
        if gradient is None:
            return
        gradient = finite_part(gradient)
        self._visits[row] += 1
        rows, visits = slice(row, row + 1), self._visits[row]
        if self._dense:
            rows, visits = slice(None), sum(self._visits)
            own, gradient = gradient, torch.zeros_like(self.values)
            gradient[row] = own
        values, first, second = self.values[rows], self._first[rows], self._second[rows]
        self._adam(values, gradient.view_as(values), first, second, step=visits, rate=rate, epsilon=_EPSILON)
