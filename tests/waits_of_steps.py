"""An observer of a training on a pretended device: each step's own loss, and what the host waited for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from made_up import Recorder


class Steps(Recorder):
    """Keeps every step's own loss, and what the host waited for in it."""

    def __init__(self, own_loss: Callable[[], Any], all_waits: list[str]) -> None:
        super().__init__()
        self.own: list[float] = []
        self.waits: list[dict[str, int]] = []
        self._own_loss, self._all_waits = own_loss, all_waits

    def after_step(self, step: int, loss: float) -> bool:
        """Read the step's own loss, which `loss` need not be."""
        self.waits.append(dict(Counter(self._all_waits)))
        self.own.append(float(self._own_loss()))
        self._all_waits.clear()
        return super().after_step(step, loss)
