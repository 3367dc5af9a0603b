"""When density control is due."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class DensityPace:
    """Every so many steps, but not in a block of rest: what was due in the block is due after the first step behind
    it."""

    def __init__(self, every: int):
        self._every = every
        self.resting = self._overdue = False

    @contextmanager
    def rest(self) -> Iterator[None]:
        """A block in which no Gaussians are added, removed or moved, and no opacities reset."""
        self.resting = True
        try:
            yield
        finally:
            self.resting = False

    def due(self, step: int) -> bool:
        """Whether it is time after step number `step`; to be asked once after every step."""
        due = step % self._every == 0 or self._overdue
        self._overdue = self.resting and due
        return due and not self.resting
