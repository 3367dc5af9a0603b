"""The one place where making a dataset talks to the user."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Protocol

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
        if self._console.is_terminal:
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("{task.description:<16}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
            with Progress(*columns, console=self._console) as bars:
                task = bars.add_task(name, total=total)
                yield lambda done: bars.update(task, completed=done)
            return
        start = last = time.monotonic()

        def advance(done: int) -> None:
            nonlocal last
            now = time.monotonic()
            if 0 < done < total and now - last >= self._interval:
                last = now
                left = (now - start) * (total - done) / done
                self._line(f"{name}: {done} of {total}, {left:.0f} s left")

        self._line(f"{name}: 0 of {total}")
        yield advance
        self._line(f"{name}: {total} of {total}, {time.monotonic() - start:.0f} s")

    def finished(self, folder: Path, message: str) -> None:
        """Say where the dataset is."""
        print(f"{folder}: {message}", flush=True)

    def _line(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)
