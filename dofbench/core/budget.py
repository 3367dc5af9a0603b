"""How long a training may take, and how a user says it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dofbench.core.errors import InputError


@dataclass(frozen=True)
class Budget:
    """When to stop: after so many steps or seconds of training, whichever comes first. Seconds alone are all used,
    however many steps a method's preset has; a budget that says nothing leaves the length to the preset.

    As text it is the shortest that `parse_budget` reads back: "300s", "7000it" or "300s,7000it".
    """

    steps: int | None = None
    seconds: float | None = None

    def progress(self, step: int, preset: int, seconds: Callable[[], float]) -> float:
        """The share of a training that is over after `step`, by steps or by time, whichever is more.
        preset: steps of the method's preset, the length of a training without a budget. seconds: tells the training
        time so far; asked only where time is limited."""
        if self.seconds is None:
            return step / (self.steps or preset)
        by_time = seconds() / self.seconds
        return by_time if self.steps is None else max(step / self.steps, by_time)

    def __str__(self) -> str:
        parts = []
        if self.seconds is not None:
            short = f"{self.seconds:g}"
            parts.append(f"{short if float(short) == self.seconds else repr(self.seconds)}s")
        if self.steps is not None:
            parts.append(f"{self.steps}it")
        return ",".join(parts)


def parse_budget(text: str) -> Budget:
    """Read "300s", "5min", "7000it" or "300s,7000it". Raises InputError for anything else."""
    steps: int | None = None
    seconds: float | None = None
    expected = "seconds (300s), minutes (5min), steps (7000it) or time and steps (300s,7000it), each above zero"
    for part in text.replace(" ", "").split(","):
        try:
            if part.endswith("it") and steps is None:
                steps = int(part[:-2])
                good = steps > 0
            elif part.endswith(("s", "min")) and seconds is None:
                seconds = 60 * float(part[:-3]) if part.endswith("min") else float(part[:-1])
                good = 0 < seconds < float("inf")
            else:
                good = False
        except ValueError:
            good = False
        if not good:
            raise InputError("budget", repr(text), expected)
    return Budget(steps=steps, seconds=seconds)
