"""The one place where making a dataset talks to the user."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Protocol

from dofbench.core.processes import Outcome
from dofbench.core.time_left import Remaining

Advance = Callable[[int], None]


class Progress(Protocol):
    """Told what goes on. `stage` opens a stage of `total` items and yields a function to report how many are done."""

    def stage(self, name: str, total: int) -> AbstractContextManager[Advance]:
        """A stage begins; it ends with the context."""

    def finished(self, folder: Path, message: str) -> None:
        """The dataset in `folder` is complete."""


class Silent:
    """Says nothing."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        """Ignored."""
        yield lambda done: None

    def finished(self, folder: Path, message: str) -> None:
        """Ignored."""


class Terminal:
    """Progress with a time estimate on standard error; where the files are on standard output.

    On a terminal it is a bar; elsewhere (a log file) it is a line every `interval` seconds.
    """

    def __init__(self, interval: float = 15.0):
        from rich.console import Console

        self._console, self._interval = Console(stderr=True), interval

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        """Show the stage until the context ends."""
        remaining = Remaining(total)
        if self._console.is_terminal:
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

            columns = (
                TextColumn("{task.description:<16}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[left]}"),
            )
            with Progress(*columns, console=self._console) as bars:
                task = bars.add_task(name, total=total, left="")

                def show(done: int) -> None:
                    remaining.told(done, time.monotonic())
                    bars.update(task, completed=done, left=remaining.text())

                yield show
            return
        start = last = time.monotonic()

        def advance(done: int) -> None:
            nonlocal last
            now = time.monotonic()
            remaining.told(done, now)
            if 0 < done < total and now - last >= self._interval:
                last = now
                self._line(f"{name}: {done} of {total}, {remaining.text()}")

        self._line(f"{name}: 0 of {total}")
        yield advance
        self._line(f"{name}: {total} of {total}, {time.monotonic() - start:.0f} s")

    def finished(self, folder: Path, message: str) -> None:
        """Say where the dataset is."""
        print(f"{folder}: {message}", flush=True)

    def _line(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)


class Several:
    """Progress of several jobs done side by side, as their watcher (`dofbench.core.processes`).

    Reports are (stage, items done, items in all; 0 where nothing is counted). The time left is known from the first job
    finished on, or from the beginning where `expected` says how many seconds one takes. It is the mean of all that are
    finished: each is a process of its own, so that all of them start cold. things: what the jobs make.
    """

    def __init__(
        self,
        total: int,
        workers: int,
        interval: float = 15.0,
        *,
        things: str = "datasets",
        expected: float | None = None,
    ):
        from rich.console import Console

        self._console, self._interval = Console(stderr=True), interval
        self._total, self._workers, self._things, self._expected = total, workers, things, expected
        self._begun: dict[str, float] = {}
        self._doing: dict[str, str] = {}
        self._times: list[float] = []
        self._ended = 0
        self._last = time.monotonic()

    def started(self, name: str) -> None:
        """A job's process runs."""
        self._begun[name] = time.monotonic()
        self._doing[name] = "starting"

    def reported(self, name: str, report: tuple[str, int, int]) -> None:
        """Say now and then what is being done."""
        stage, done, total = report
        self._doing[name] = f"{stage} {done} of {total}" if total else stage
        if time.monotonic() - self._last >= self._interval:
            self._say()

    def ended(self, outcome: Outcome) -> None:
        """Say how a job ended: its message on standard output, what went wrong on standard error."""
        self._times.append(time.monotonic() - self._begun.pop(outcome.name))
        del self._doing[outcome.name]
        self._ended += 1
        if outcome.problem:
            self._line(f"{outcome.name}: {outcome.problem}")
        else:
            print(outcome.message, flush=True)
        self._say()

    def _say(self) -> None:
        self._last = now = time.monotonic()
        parts = [f"{self._ended} of {self._total} {self._things}"]
        mean = sum(self._times) / len(self._times) if self._times else self._expected
        if mean is not None and self._ended < self._total:
            spent = sum(min(now - begun, mean) for begun in self._begun.values())
            left = (mean * (self._total - self._ended) - spent) / min(self._workers, self._total - self._ended)
            parts[0] += f", about {left:.0f} s left"
        self._line("; ".join([*parts, *(f"{name}: {doing}" for name, doing in self._doing.items())]))

    def _line(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)
