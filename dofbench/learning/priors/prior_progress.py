"""What a prior says while it is made."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Told how far a stage of the work is, as `dofbench.core.contracts.Observer.stage` is."""

    def __call__(self, name: str, done: int, total: int) -> None:
        """`done` of the stage's `total` units are finished; 0 says that it begins."""


def silent(name: str, done: int, total: int) -> None:
    """A `Progress` that says nothing."""
