"""Where the seconds of a training go, by part of the step."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class StageClock:
    """Adds up seconds by stage. What is timed within another stage counts to its own alone."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._within = [0.0]  # of each open stage, what other stages in it have taken

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Counts the seconds of the block."""
        self._within.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            own = spent - self._within.pop()
            self._within[-1] += spent
            self.seconds[stage] = self.seconds.get(stage, 0.0) + own
