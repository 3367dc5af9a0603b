"""Photographs that don't belong to the scene, such as those whose pose is wrong.

A photograph that the others contradict keeps a loss far above theirs, and is left out. Medians tell it, so a scene that
is merely hard to learn has no outliers.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

VISITS = 2  # of a view that its loss is averaged over
FAR = 4.0  # robust standard deviations of the losses' logarithms
LEAST_RATIO = 1.4  # times the median loss, so that views that are all alike have no outlier
MOST = 0.25  # share of the views that may be left out
LEAST_VIEWS = 8  # for a median to mean something


@dataclass(frozen=True)
class OutlierOptions:
    """Whether photographs may be left out, and from when on."""

    outlier_views: bool = False
    """Whether views whose loss stays far above the others' are left out. Unit: none. Source: own."""
    outliers_from: float = 0.3
    """When they are looked for. Unit: share of the training. Source: own."""


class OutlierViews:
    """Keeps each view's latest losses, and says which views are left out."""

    def __init__(self, count: int):
        self._losses: list[deque[float]] = [deque(maxlen=VISITS) for _ in range(count)]

    def record(self, view: int, loss: float) -> None:
        """The loss of a step on view number `view`."""
        self._losses[view].append(loss)

    def found(self) -> set[int]:
        """Numbers of the views whose loss is an outlier; none until all have been seen often enough."""
        if len(self._losses) < LEAST_VIEWS or any(len(losses) < VISITS for losses in self._losses):
            return set()
        logs = np.log([np.mean(losses) for losses in self._losses])
        above = logs - np.median(logs)
        bound = max(FAR * 1.4826 * float(np.median(np.abs(above))), np.log(LEAST_RATIO))
        worst = np.argsort(-above)[: int(MOST * len(logs))]
        return {int(view) for view in worst if above[view] > bound}
