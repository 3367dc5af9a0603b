"""What doesn't belong to the scene: photographs whose pose is wrong, and things that only few of them show.

A photograph that the others contradict keeps a loss far above theirs: it is left out. A thing that wasn't there when
the others were taken keeps a patch of large differences: the patch is left out. Both are told by medians, so a scene
that is merely hard to learn has no outliers.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

VISITS = 2            # of a view that its loss is averaged over
FAR = 4.0             # robust standard deviations of the losses' logarithms
LEAST_RATIO = 1.6     # times the median loss, so that views that are all alike have no outlier
MOST = 0.25           # share of the views that may be left out
LEAST_VIEWS = 8       # for a median to mean something
PATCH = 9             # px over which differences are averaged
UNEXPLAINED = 8.0     # times the photograph's median difference
LEAST_DIFFERENCE = 0.1


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
        worst = np.argsort(-above)[:int(MOST * len(logs))]
        return {int(view) for view in worst if above[view] > bound}


@torch.no_grad()
def unexplained(prediction: Tensor, target: Tensor) -> Tensor:
    """(H, W) bool: where images (H, W, 3) differ over a patch by far more than they mostly do."""
    difference = (prediction - target).abs().mean(dim=-1)
    patches = avg_pool2d(difference[None, None], PATCH, stride=1, padding=PATCH // 2, count_include_pad=False)[0, 0]
    bound = torch.clamp(UNEXPLAINED * patches.median(), min=LEAST_DIFFERENCE)
    return patches > bound
