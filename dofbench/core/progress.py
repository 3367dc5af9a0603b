"""Progress of work: one interface, shown by rich on a terminal, as lines in a log, or sent to another process."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dofbench.core.jobs import FREED, Outcome, Report, Watcher
from dofbench.core.time_left import ESTIMATING, Remaining

if TYPE_CHECKING:
    from rich.console import Console

Advance = Callable[[int], None]
Update = Callable[[str, int, int], None]
INTERVAL = 10.0  # seconds between two lines of a log: it stays readable, and shows that work goes on
_REPORT_EVERY = 2.0  # seconds between two reports to another process


def say(console: Console, line: str) -> None:
    """Print one line as it is: rich would colour numbers, read brackets as markup and break paths."""
    console.print(line, highlight=False, markup=False, soft_wrap=True)


def silent(stage: str, done: int, total: int) -> None:
    """An `Update` that shows nothing."""


class Progress:
    """Shows the progress of work; this base shows nothing."""

    def update(self, stage: str, done: float, total: float, detail: str = "", left: float | None = None) -> None:
        """Show that `done` of the stage's `total` units are finished, 0 at its beginning.

        total: 0 if uncounted. left: seconds that are left at most, where a limit is known.
        """

    def close(self) -> None:
        """The stages so far are over: take a bar away."""

    def accelerator_free(self) -> None:
        """The work needs its accelerator no longer for itself."""

    def finished(self, folder: Path, message: str) -> None:
        """The dataset in `folder` is complete."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Advance]:
        """Show a stage of `total` units during the block, which is given a function to report how many are done."""
        self.update(name, 0, total)
        try:
            yield lambda done: self.update(name, done, total)
        finally:
            self.close()

    @contextmanager
    def uncounted(self, name: str, every: float = INTERVAL) -> Iterator[None]:
        """Show a stage that counts nothing, such as JIT compilation, and every so many seconds that it goes on."""
        over, begun = threading.Event(), time.monotonic()

        def tell() -> None:
            while not over.wait(every):
                self.update(name, 0, 0, f"{time.monotonic() - begun:.0f} s")

        self.update(name, 0, 0)
        thread = threading.Thread(target=tell, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            self.close()


class Silent(Progress):
    """Progress that nobody is shown."""


class Terminal(Progress):
    """Progress with the time left: a bar on a terminal, elsewhere a line every `interval` seconds.

    console: standard error by default; the folders that are finished go to standard output.
    """

    def __init__(self, console: Console | None = None, interval: float = INTERVAL):
        from rich.console import Console

        self._console, self._interval = console or Console(stderr=True), interval
        self._bar: Any = None
        self._stage, self._begun, self._last = "", 0.0, -math.inf
        self._remaining = Remaining(1)

    def update(self, stage: str, done: float, total: float, detail: str = "", left: float | None = None) -> None:
        """Show it: a bar always, a line at the stage's beginning and end and every few seconds."""
        now = time.monotonic()
        begins = stage != self._stage
        if begins:
            self._stage, self._begun, self._remaining = stage, now, Remaining(total)
        self._remaining.told(done, now)
        known = [seconds for seconds in (self._remaining.seconds(), left) if seconds is not None]
        rest = "" if not total else f"about {min(known):.0f} s left" if known else ESTIMATING
        count = f"{done:.0f} of {total:.0f}" if total else ""
        if self._console.is_terminal:
            self._show_bar(stage, done, total, ", ".join(filter(None, (count, detail))), rest)
            return
        over = bool(total) and done >= total
        if begins or over or now - self._last >= self._interval:
            took = f"{now - self._begun:.0f} s" if over else rest if done else ""
            self._last = now
            say(self._console, f"{stage}: {', '.join(filter(None, (count, detail, took)))}".removesuffix(": "))

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
        self._bar, self._stage = None, ""

    def finished(self, folder: Path, message: str) -> None:
        """Say where the dataset is."""
        print(f"{folder}: {message}", flush=True)

    def _show_bar(self, stage: str, done: float, total: float, detail: str, left: str) -> None:
        if self._bar is None:
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bars

            words = (TextColumn("{task.fields[detail]}"), TimeElapsedColumn(), TextColumn("{task.fields[left]}"))
            self._bar = Bars(TextColumn("{task.description}"), BarColumn(), *words, console=self._console)
            self._bar.start()
            self._task = self._bar.add_task(stage, detail=detail, left=left)
        total = total or 1.0
        self._bar.update(self._task, description=stage, completed=done, total=total, detail=detail, left=left)


class Reported(Progress):
    """Progress that goes to another process, by the function that a job is given. message: of a finished dataset."""

    def __init__(self, report: Report):
        self._report, self.message = report, ""
        self._stage, self._last = "", -math.inf

    def update(self, stage: str, done: float, total: float, detail: str = "", left: float | None = None) -> None:
        """Report a stage's beginning, and its progress every few seconds."""
        now = time.monotonic()
        if stage != self._stage or now - self._last >= _REPORT_EVERY:
            self._stage, self._last = stage, now
            self._report((stage if total else f"{stage} {detail}".strip(), round(done), round(total)))

    def accelerator_free(self) -> None:
        """Report it: another job may use the accelerator now."""
        self._report(FREED)

    def finished(self, folder: Path, message: str) -> None:
        """Keep the message, which is printed when the job ends."""
        self.message = f"{folder}: {message}"


class Several(Watcher):
    """Shows the progress of several jobs done side by side, on standard error.

    Reports are (stage, items done, items in all; 0 where nothing is counted). The time left is known from the beginning
    where `expected` says how many seconds jobs take, by name; those that it doesn't name take as long as the others on
    average. Once jobs have ended, expectations are corrected by the ratio of what they took to what was expected.
    Without any expectation the time left is known from the first job ended on. things: what the jobs make. after:
    called with each outcome, once it is shown.
    """

    def __init__(
        self,
        total: int,
        workers: int,
        interval: float = 15.0,
        *,
        things: str = "datasets",
        expected: Mapping[str, float] | None = None,
        after: Callable[[Outcome], None] = lambda outcome: None,
    ):
        from rich.console import Console

        self._console, self._interval, self._after = Console(stderr=True), interval, after
        self._total, self._workers, self._things = total, workers, things
        self._expected = {name: seconds for name, seconds in (expected or {}).items() if seconds > 0}
        self._begun: dict[str, float] = {}
        self._doing: dict[str, str] = {}
        self._took: dict[str, float] = {}
        self._elsewhere = 0
        self._last = time.monotonic()

    def started(self, name: str) -> None:
        """Count the job among those at work."""
        self._begun[name] = time.monotonic()
        self._doing[name] = "starting"

    def reported(self, name: str, report: tuple[str, int, int]) -> None:
        """Show now and then what is being done."""
        stage, done, total = report
        self._doing[name] = f"{stage} {done} of {total}" if total else stage
        if time.monotonic() - self._last >= self._interval:
            self._show()

    def put_off(self, name: str) -> None:
        """Count the job as waiting again."""
        del self._begun[name], self._doing[name]

    def idle(self, waiting: int) -> None:
        """Show now and then what is waited for."""
        if time.monotonic() - self._last >= self._interval:
            self._last = time.monotonic()
            say(self._console, f"waiting for other processes, which have {waiting} {self._things} or their GPU at work")

    def ended(self, outcome: Outcome) -> None:
        """Show how a job ended: its message on standard output, what went wrong on standard error."""
        if outcome.name in self._begun:
            self._took[outcome.name] = time.monotonic() - self._begun.pop(outcome.name)
            del self._doing[outcome.name]
        else:  # by another process
            self._total -= 1
            self._elsewhere += 1
            self._expected.pop(outcome.name, None)
        if outcome.problem:
            say(self._console, f"{outcome.name}: {outcome.problem}")
        else:
            print(outcome.message, flush=True)
        self._show()
        self._after(outcome)

    def _show(self) -> None:
        self._last = now = time.monotonic()
        parts = [f"{len(self._took) + self._elsewhere} of {self._total + self._elsewhere} {self._things}"]
        left = self._seconds_left(now)
        if left is not None:
            parts[0] += f", about {left:.0f} s left"
        say(self._console, "; ".join([*parts, *(f"{name}: {doing}" for name, doing in self._doing.items())]))

    def _seconds_left(self, now: float) -> float | None:
        """None as long as it is unknown, and when all is done."""
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
