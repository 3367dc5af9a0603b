"""What is said to the user while work goes on: lines, bars, and how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from dofbench.core.jobs import Outcome
from dofbench.core.time_left import Remaining

if TYPE_CHECKING:
    from rich.console import Console

Advance = Callable[[int], None]


def say(console: Console, line: str) -> None:
    """Print one line as it is: rich would colour numbers, read brackets as markup and break paths."""
    console.print(line, highlight=False, markup=False, soft_wrap=True)


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
        say(self._console, text)


class Several:
    """Progress of several jobs done side by side, as their watcher (`dofbench.core.jobs`).

    Reports are (stage, items done, items in all; 0 where nothing is counted). The time left is known from the beginning
    where `expected` says how many seconds jobs take, by name; those that it doesn't name take as long as the others on
    average. Once jobs have ended, expectations are corrected by the ratio of what they took to what was expected.
    Without any expectation the time left is known from the first job ended on. things: what the jobs make.
    """

    def __init__(
        self,
        total: int,
        workers: int,
        interval: float = 15.0,
        *,
        things: str = "datasets",
        expected: Mapping[str, float] | None = None,
    ):
        from rich.console import Console

        self._console, self._interval = Console(stderr=True), interval
        self._total, self._workers, self._things = total, workers, things
        self._expected = {name: seconds for name, seconds in (expected or {}).items() if seconds > 0}
        self._begun: dict[str, float] = {}
        self._doing: dict[str, str] = {}
        self._took: dict[str, float] = {}
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

    def put_off(self, name: str) -> None:
        """A job is left for later."""
        del self._begun[name], self._doing[name]

    def ended(self, outcome: Outcome) -> None:
        """Say how a job ended: its message on standard output, what went wrong on standard error."""
        self._took[outcome.name] = time.monotonic() - self._begun.pop(outcome.name)
        del self._doing[outcome.name]
        if outcome.problem:
            self._line(f"{outcome.name}: {outcome.problem}")
        else:
            print(outcome.message, flush=True)
        self._say()

    def _say(self) -> None:
        self._last = now = time.monotonic()
        parts = [f"{len(self._took)} of {self._total} {self._things}"]
        left = self._seconds_left(now)
        if left is not None:
            parts[0] += f", about {left:.0f} s left"
        self._line("; ".join([*parts, *(f"{name}: {doing}" for name, doing in self._doing.items())]))

    def _seconds_left(self, now: float) -> float | None:
        """None as long as nobody can know, and when all is done."""
        if len(self._took) == self._total:
            return None
        both = [name for name in self._took if name in self._expected]
        pace = sum(self._took[name] for name in both) / sum(self._expected[name] for name in both) if both else 1.0
        known = {**{name: pace * seconds for name, seconds in self._expected.items()}, **self._took}
        if not known:
            return None
        usual = sum(known.values()) / len(known)
        named = {name: seconds for name, seconds in known.items() if name not in self._took}
        others = self._total - len(self._took) - len(named.keys() | self._begun.keys())
        at_work = {name: known.get(name, usual) for name in self._begun}
        left = sum(seconds for name, seconds in named.items() if name not in at_work) + max(others, 0) * usual
        left += sum(max(0.0, seconds - (now - self._begun[name])) for name, seconds in at_work.items())
        return left / min(self._workers, self._total - len(self._took))

    def _line(self, text: str) -> None:
        say(self._console, text)
