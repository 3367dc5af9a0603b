"""The loss that a training tells its observer, without having the host wait for a device at every step."""

from __future__ import annotations

import math

from torch import Tensor

from dofbench.training.common.nonfinite import Watch

_LOOK_EVERY = 50  # steps, between two looks at what a device has found


class SeenLoss:
    """The loss that was looked at last. Looking at one also looks at what the `watch` has gathered, since the host then
    waits for the device anyway."""

    def __init__(self, watch: Watch):
        self._watch = watch
        self._loss, self._next_look = math.nan, 0

    def after(self, step: int, loss: Tensor) -> float:
        """On the CPU the loss of this step; on a device that of the last step looked at. Raises NonFiniteError as
        `Watch.look` does."""
        if loss.device.type == "cpu" or step >= self._next_look:
            self._watch.look()
            self._loss, self._next_look = float(loss.detach()), step + _LOOK_EVERY
        return self._loss
