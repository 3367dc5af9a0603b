"""Adam over a small table of parameters, of which each training step updates one row."""

from __future__ import annotations

import torch
from torch import Tensor

from dofbench.learning.nonfinite import finite_part

_BETAS = (0.9, 0.999)
_EPSILON = 1e-15


class RowAdam:
    """Parameters that start at `values` (rows, columns), which are changed; each row's moments depend on the steps on
    that row alone (Adam: Kingma and Ba, 2015)."""

    def __init__(self, values: Tensor):
        self.values = values
        self._first = torch.zeros_like(self.values)
        self._second = torch.zeros_like(self.values)
        self._visits = [0] * len(values)  # on the host, which would otherwise wait for the device at every step
        self._leaf: Tensor | None = None

    def leaf(self, row: int) -> Tensor:
        """(columns,) parameters of a row as a leaf tensor that collects gradients; kept for `step`."""
        self._leaf = self.values[row].clone().requires_grad_()
        return self._leaf

    @property
    def gradient(self) -> Tensor | None:
        """(columns,) gradient with respect to the row of the last `leaf`; None if the loss didn't depend on it."""
        return None if self._leaf is None else self._leaf.grad

    def step(self, row: int, rate: float) -> None:
        """One Adam step on a row; does nothing if the row has no gradient."""
        gradient = self.gradient
        self._leaf = None
        if gradient is None:
            return
        gradient = finite_part(gradient)
        self._visits[row] += 1
        beta1, beta2 = _BETAS
        self._first[row] = beta1 * self._first[row] + (1 - beta1) * gradient
        self._second[row] = beta2 * self._second[row] + (1 - beta2) * gradient.square()
        visits = self._visits[row]
        first, second = self._first[row] / (1 - beta1**visits), self._second[row] / (1 - beta2**visits)
        self.values[row] -= rate * first / (second.sqrt() + _EPSILON)
