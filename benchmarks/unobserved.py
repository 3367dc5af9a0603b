"""An observer for trainings that a bench runs by itself: it keeps the time and never ends a training."""

from __future__ import annotations

import time


class Unobserved:
    """Implements `dofbench.core.contracts.Observer`; the clock begins when it is made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Wall seconds since it was made."""
        return time.perf_counter() - self._start

    def after_step(self, step: int, loss: float) -> bool:
        """Go on."""
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        """Nobody looks."""
