"""How long a piece of work still takes, from how fast it has been going lately."""

from __future__ import annotations

from collections import deque
from typing import Protocol


class Progress(Protocol):
    """Told how far a piece of work is."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """`done` units of the stage's `total` are finished; 0 says that it begins."""


def silent(stage: str, done: int, total: int) -> None:
    """A `Progress` that says nothing."""


class Remaining:
    """Seconds left of one stage, by the rate over the later half of the time since its first unit was done.

    What the first unit took says nothing: it pays for what happens once, such as compiling and reading files.
    """

    def __init__(self) -> None:
        self._begun: float | None = None
        self._reports: deque[tuple[float, float]] = deque()

    def __call__(self, done: float, total: float, now: float) -> float | None:
        """Seconds left at time `now` (s, of any clock that goes forward), or None while there is no telling."""
        if done > 0 and (not self._reports or done > self._reports[-1][0]):
            self._begun = now if self._begun is None else self._begun
            self._reports.append((done, now))
        if done >= total:
            return 0.0
        if len(self._reports) < 2:
            return None
        last, ended = self._reports[-1]
        while len(self._reports) > 2 and self._reports[1][1] <= (self._begun + ended) / 2:
            self._reports.popleft()
        first, begun = self._reports[0]
        # Since the last unit was done, some time of the next one has passed.
        return max((total - last) * (ended - begun) / (last - first) - (now - ended), 0.0)
