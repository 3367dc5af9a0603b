"""Photographs that don't belong to the scene, such as those whose pose is wrong.

A photograph that contradicts the others keeps a loss far above theirs, and is left out. Losses are compared with their
median, so a scene that is hard to learn as a whole has no outliers.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from torch import Tensor

VISITS = 2  # number of latest visits of a view over which its loss is averaged
FAR = 4.0  # distance from which a view is an outlier, in robust standard deviations of the losses' logarithms
# Least ratio of an outlier's loss to the median, so that views of nearly equal losses have no outlier
LEAST_RATIO = 1.4
MOST = 0.25  # largest share of the views that may be left out
LEAST_VIEWS = 8  # fewest views for which the median is meaningful


@dataclass(frozen=True)
class OutlierOptions:
    """Whether photographs may be left out, and from when on."""

    outlier_views: bool = False
    """Whether views whose loss stays far above the others' are left out. Unit: none. Source: own."""
    outliers_from: float = 0.3
    """When the search for such views begins. Unit: share of the training. Source: own."""


class OutlierViews:
    """Keeps each view's latest losses, and finds the outliers among the views."""

    def __init__(self, count: int):
        self._losses: list[deque[Tensor]] = [deque(maxlen=VISITS) for _ in range(count)]

    def record(self, view: int, loss: Tensor) -> None:
        """Add the loss of a step on view number `view`."""
        self._losses[view].append(loss)

    def found(self) -> set[int]:
        """Numbers of the views whose loss is an outlier; none until all have been seen often enough."""
        if len(self._losses) < LEAST_VIEWS or any(len(losses) < VISITS for losses in self._losses):
            return set()
        logs = np.log([np.mean([float(loss) for loss in losses]) for losses in self._losses])
        above = logs - np.median(logs)
        bound = max(FAR * 1.4826 * float(np.median(np.abs(above))), np.log(LEAST_RATIO))
        worst = np.argsort(-above)[: int(MOST * len(logs))]
        return {int(view) for view in worst if above[view] > bound}
