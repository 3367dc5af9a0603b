"""The time of a training by part of the training step."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StageClock:
    """Adds up seconds by stage. Time spent in a nested stage counts for the nested stage only."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._within = [0.0]  # for each open stage, the seconds of the stages nested in it

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Adds the seconds of the block to the stage."""
        self._within.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            own = spent - self._within.pop()
            self._within[-1] += spent
            self.seconds[stage] = self.seconds.get(stage, 0.0) + own
