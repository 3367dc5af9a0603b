"""The order in which training visits the photographs: rounds of all photographs in random order, without the
outliers."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from dofbench.training.common.outliers import OutlierOptions, OutlierViews


@dataclass(frozen=True, eq=False)
class OrderState:
    """A copy of a `ViewOrder`'s state: the rest of the current round, and the losses."""

    left: list[int]
    outliers: OutlierViews


class ViewOrder:
    """Yields the numbers of `count` photographs in rounds. left_out: photographs found not to belong to the scene."""

    def __init__(self, count: int, options: OutlierOptions):
        self._count, self._options = count, options
        self._left: list[int] = []
        self._outliers = OutlierViews(count)
        self.left_out: set[int] = set()

    def next(self, progress: float, random: np.random.Generator) -> int:
        """The next photograph's number at `progress`, 0 to 1; a new round is drawn when the last one is over."""
        if not self._left:
            self._left = list(random.permutation(self._count))
            if self._options.outlier_views and progress >= self._options.outliers_from:
                self.left_out |= self._outliers.found()
                self._left = [view for view in self._left if view not in self.left_out]
        return self._left.pop()

    def record(self, view: int, loss: Tensor) -> None:
        """Add the loss of a step on view number `view`."""
        self._outliers.record(view, loss)

    def state(self) -> OrderState:
        """A copy of the current round and the losses. `left_out` isn't part of it: outliers stay left out."""
        return OrderState(list(self._left), copy.deepcopy(self._outliers))

    def restore(self, state: OrderState) -> None:
        """Return to an earlier `state`."""
        self._left, self._outliers = list(state.left), copy.deepcopy(state.outliers)
