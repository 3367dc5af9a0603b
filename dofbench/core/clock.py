"""Wall and CPU time by stage, and the training clock that stands still while the harness evaluates.

Nothing heavy is imported here: `loading` runs while the rest is.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime


class Stopwatch:
    """Adds up wall and CPU seconds over every stretch that it runs.

    CPU seconds are the process's over all threads, so on two busy cores they grow twice as fast; those of a process
    that it started are added when that has ended.
    """

    def __init__(self) -> None:
        self._wall = self._cpu = 0.0
        self._since: tuple[float, float] | None = None

    @property
    def wall(self) -> float:
        """Wall seconds so far, running stretch included."""
        return self._wall + (time.perf_counter() - self._since[0] if self._since else 0.0)

    @property
    def cpu(self) -> float:
        """CPU seconds so far, running stretch included."""
        return self._cpu + (_cpu_seconds() - self._since[1] if self._since else 0.0)

    def start(self) -> None:
        """Start a stretch. Raises RuntimeError if one is running."""
        if self._since:
            raise RuntimeError("stopwatch: started twice")
        self._since = time.perf_counter(), _cpu_seconds()

    def stop(self) -> None:
        """End the running stretch; without one, nothing happens."""
        self._wall, self._cpu, self._since = self.wall, self.cpu, None

    def move(self, other: Stopwatch) -> None:
        """Add another's seconds, which start again from nothing."""
        other.stop()
        self._wall, self._cpu = self._wall + other._wall, self._cpu + other._cpu
        other._wall = other._cpu = 0.0

    def add(self, wall: float, cpu: float) -> None:
        """Add seconds of an earlier process, whose work goes on in this one."""
        self._wall, self._cpu = self._wall + wall, self._cpu + cpu

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run during the block; a block within another one of the same watch counts once."""
        if self._since:
            yield
            return
        self.start()
        try:
            yield
        finally:
            self.stop()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stand still during the block; goes on afterwards if it was running before."""
        was_running = self._since is not None
        self.stop()
        try:
            yield
        finally:
            if was_running:
                self.start()


class StageTimes:
    """One stopwatch a stage, in the order of first use."""

    def __init__(self) -> None:
        self._stages: dict[str, Stopwatch] = {}

    def __getitem__(self, name: str) -> Stopwatch:
        return self._stages.setdefault(name, Stopwatch())

    def as_data(self) -> dict[str, dict[str, float]]:
        """stage -> {"wall": seconds, "cpu": seconds}."""
        return {name: {"wall": watch.wall, "cpu": watch.cpu} for name, watch in self._stages.items()}


# Time spent on importing heavy modules, and on planning without these; the first run of a process reports both.
loading, planning = Stopwatch(), Stopwatch()


def timestamp() -> str:
    """The time of day, UTC, to the second, as ISO 8601 has it."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _cpu_seconds() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime
