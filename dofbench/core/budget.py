"""How long a training may take, and how a user says it."""

from __future__ import annotations

from dataclasses import dataclass

from dofbench.core.errors import InputError


@dataclass(frozen=True)
class Budget:
    """When to stop: after so many steps or seconds of training, whichever comes first. Seconds alone are all used,
    however many steps a method's preset has; a budget that says nothing leaves the length to the preset.

    As text it is the shortest that `parse_budget` reads back: "300s", "60cpu", "7000it" or "300s,7000it".

    processor: the seconds are of processor time, over all threads, which other work on the machine hardly changes.
    """

    steps: int | None = None
    seconds: float | None = None
    processor: bool = False

    def __str__(self) -> str:
        parts = []
        if self.seconds is not None:
            short = f"{self.seconds:g}"
            unit = "cpu" if self.processor else "s"
            parts.append(f"{short if float(short) == self.seconds else repr(self.seconds)}{unit}")
        if self.steps is not None:
            parts.append(f"{self.steps}it")
        return ",".join(parts)


def parse_budget(text: str) -> Budget:
    """Read "300s", "5min", "60cpu", "7000it" or "300s,7000it". Raises InputError for anything else."""
    steps: int | None = None
    seconds: float | None = None
    processor = False
    expected = (
        "seconds (300s), minutes (5min), processor seconds (60cpu), steps (7000it) or time and steps (300s,7000it), "
        "each above zero"
    )
    for part in text.replace(" ", "").split(","):
        try:
            if part.endswith("it") and steps is None:
                steps = int(part[:-2])
                good = steps > 0
            elif part.endswith(("s", "min", "cpu")) and seconds is None:
                processor = part.endswith("cpu")
                seconds = float(part[:-1]) if part.endswith("s") else float(part[:-3])
                seconds *= 60 if part.endswith("min") else 1
                good = 0 < seconds < float("inf")
            else:
                good = False
        except ValueError:
            good = False
        if not good:
            raise InputError("budget", repr(text), expected)
    return Budget(steps=steps, seconds=seconds, processor=processor)
