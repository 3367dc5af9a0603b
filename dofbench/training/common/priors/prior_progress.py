"""The callback by which making a prior reports its progress."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called with the progress of a stage of the work, like `dofbench.core.contracts.Observer.stage`."""

    def __call__(self, name: str, done: int, total: int) -> None:
        """`done` of the stage's `total` units are finished; 0 means that the stage begins."""


def silent(name: str, done: int, total: int) -> None:
    """A `Progress` that ignores all calls."""
