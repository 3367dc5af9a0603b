"""Adam over a small table of which each training step sees one row."""

from __future__ import annotations

import torch
from torch import Tensor

_BETAS = (0.9, 0.999)
_EPSILON = 1e-15


class RowAdam:
    """Parameters (rows, columns) from zero; a row's moments count its own visits (Kingma and Ba, 2015)."""

    def __init__(self, rows: int, columns: int):
        self.values = torch.zeros(rows, columns)
        self._first = torch.zeros(rows, columns)
        self._second = torch.zeros(rows, columns)
        self._visits = torch.zeros(rows)
        self._leaf: Tensor | None = None

    def leaf(self, row: int) -> Tensor:
        """(columns,) of a row, which gradient reaches; remembered for `step`."""
        self._leaf = self.values[row].clone().requires_grad_()
        return self._leaf

    @property
    def gradient(self) -> Tensor | None:
        """(columns,) gradient by the row of the last `leaf`; None when nothing reached it."""
        return None if self._leaf is None else self._leaf.grad

    def step(self, row: int, rate: float) -> None:
        """One step on a row; does nothing when no gradient reached it."""
        gradient = self.gradient
        self._leaf = None
        if gradient is None:
            return
        self._visits[row] += 1
        beta1, beta2 = _BETAS
        self._first[row] = beta1 * self._first[row] + (1 - beta1) * gradient
        self._second[row] = beta2 * self._second[row] + (1 - beta2) * gradient.square()
        visits = float(self._visits[row])
        first, second = self._first[row] / (1 - beta1**visits), self._second[row] / (1 - beta2**visits)
        self.values[row] -= rate * first / (second.sqrt() + _EPSILON)
