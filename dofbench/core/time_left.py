"""How long the rest of some work takes, from how fast it has been going lately."""

from __future__ import annotations

import itertools
import math
import statistics
from collections import deque

ESTIMATING = "estimating the time left"
_HANDFUL = 5  # units that are timed before anything is said; a quarter of all units where that is fewer
_RECENT = 30.0  # seconds that the rate is of, or the last handful of units where these took longer
_KEPT = 300  # units at most: a step may take a millisecond
_PAUSE = 10.0  # what takes so many times as long as usual is a kernel compiled, or a machine put to sleep


class Remaining:
    """Seconds left of `total` units of work, told of the units as they are done.

    What comes before the first unit is done, which imports and compiles, is no measure of the others, and neither are
    single units that take over ten times as long as most. Nothing is said until a handful of units have been timed.
    """

    def __init__(self, total: float):
        self._total = total
        self._needed = max(1, min(_HANDFUL, int(total) // 4))
        self._told: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def told(self, done: float, now: float) -> None:
        """`done` units are done at the time `now`, seconds. What is told again, or goes back, is passed over."""
        if done > 0 and (not self._told or done > self._told[-1][0]):
            self._told.append((done, now))
            while len(self._told) > self._needed + 1 and now - self._told[1][1] > _RECENT:
                self._told.popleft()

    def seconds(self) -> float | None:
        """Seconds left as of the last unit told; None as long as nobody can know."""
        told = list(self._told)
        done = sum(after[0] - before[0] for before, after in itertools.pairwise(told))
        if done < self._needed:
            return None
        paces = [
            ((after[1] - before[1]) / (after[0] - before[0]), after[0] - before[0])
            for before, after in itertools.pairwise(told)
        ]
        slowest = _PAUSE * statistics.median(pace for pace, _ in paces)
        usual = [(pace, units) for pace, units in paces if pace <= slowest or slowest == 0]
        pace = math.fsum(pace * units for pace, units in usual) / math.fsum(units for _, units in usual)
        return pace * max(0.0, self._total - told[-1][0])
