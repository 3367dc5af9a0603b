"""Adam over a small table of parameters, of which a training step needs one row, or all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby

import torch
from torch import Tensor

from dofbench.runtime.ops import load

_EPSILON = 1e-15


class RowAdam:
    """Parameters that start at `values` (rows, columns), which are changed (Adam: Kingma and Ba, 2015).

    dense: whether a step on one row updates all rows, the others with a gradient of zero, so that all rows' moments
    decay; else each row's moments depend on the steps on that row alone, or on all.
    """

    def __init__(self, values: Tensor, *, dense: bool = False):
        self.values = values
        self._dense = dense
        self._exp_avg, self._exp_avg_sq = torch.zeros_like(values), torch.zeros_like(values)
        self._visits = [0] * len(values)  # on the host, which would otherwise wait for the device at every step
        self._leaf: Tensor | None = None

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
        step_together([(self, row)], rate)

    def _due(self, row: int | None) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor, int, int]]:
        """(values, gradient, both means, number of the step, row at which the gradient begins) of what the next step
        moves, in parts of rows with as many steps behind them; nothing without a gradient."""
        gradient = self.gradient
        self._leaf = None
        if gradient is None:
            return
        rows = range(len(self.values))
        if row is not None:
            gradient = gradient[None]
            rows = rows if self._dense else range(row, row + 1)
        for number in rows:
            self._visits[number] += 1
        for visits, alike in groupby(rows, self._visits.__getitem__):
            numbers = list(alike)
            some = slice(numbers[0], numbers[-1] + 1)
            moments = self._exp_avg[some], self._exp_avg_sq[some]
            if row is None:
                yield self.values[some], gradient[some], *moments, visits, 0
            else:  # all rows, or this one alone
                yield self.values[some], gradient, *moments, visits, row - numbers[0]


def step_together(tables: Iterable[tuple[RowAdam, int | None]], rate: float) -> None:
    """`RowAdam.step` for several tables, each with its row, at one rate.

    On a device nobody has looked at gradients yet, so what isn't finite in them counts as 0.
    """
    due = [part for table, row in tables for part in table._due(row)]
    if due:
        *tensors, steps, rows = zip(*due, strict=True)
        load("adam")(*tensors, steps=steps, lrs=[rate] * len(due), eps=_EPSILON, rows=rows, finite=True)
