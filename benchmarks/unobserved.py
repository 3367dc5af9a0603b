"""An observer for trainings in benchmarks: it measures time and never ends a training."""

from __future__ import annotations

import time


class Unobserved:
    """Implements `dofbench.core.contracts.Observer`; the clock starts when the object is created."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Wall seconds since the object was created."""
        return time.perf_counter() - self._start

    def after_step(self, step: int, loss: float) -> bool:
        """Continue training: always True."""
        return True

    def stage(self, name: str, done: int, total: int) -> None:
        """Ignored."""
