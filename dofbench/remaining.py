"""How long a piece of work still takes, from how fast it has been going."""

from __future__ import annotations

from collections import deque
from typing import Protocol

RECENT = 8   # latest reports that the rate is taken from


class Progress(Protocol):
    """Told how far a piece of work is."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` units of the stage's `total` are finished; 0 says that it begins."""


def silent(stage: str, done: int, total: int) -> None:
    """A `Progress` that says nothing."""


class Remaining:
    """Seconds left of a stage, from the rate over its latest reports.

    The first unit pays for what happens once, compiling and reading files above all: no rate is taken from it unless
    it is all there is, and that only once it is done.
    """

    def __init__(self) -> None:
        self._reports: deque[tuple[float, float]] = deque(maxlen=RECENT + 1)

    def __call__(self, done: float, total: float, now: float) -> float | None:
        """Seconds left at time `now` (s, any clock that goes forward) with `done` of `total`; None: not known yet.

        Fewer done than before begins anew.
        """
        if self._reports and done < self._reports[-1][0]:
            self._reports.clear()
        if not self._reports or done > self._reports[-1][0]:
            self._reports.append((done, now))
        if done >= total:
            return 0.0
        # Two units at least are needed for a rate without the first.
        known = [report for report in self._reports if report[0] > 0]
        if len(known) < 2:
            return None
        (first, begun), (last, ended) = known[0], known[-1]
        rate = (last - first) / (ended - begun) if ended > begun else float("inf")
        # What has passed since the last report is spent already, but no more than one unit's worth is owed to it.
        return max((total - last) / rate - (now - ended), 0.0)
