"""What a run says on the terminal: a bar where there is a terminal, plain lines where there is none."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from dofbench.core.budget import Budget
from dofbench.core.evidence import ROLE_SAYS
from dofbench.core.time_left import ESTIMATING, Remaining
from dofbench.evaluation.results.result import Result
from dofbench.running.observer import Report, share_spent

PLAIN_EVERY = 10.0  # seconds between two plain lines: a log stays readable, and shows that it is alive


class TrainingProgress:
    """Shows step, loss and the training time left: a budget in seconds says it, steps by their recent rate.

    Before the first step it shows the stages that lead there, each with the time left of it alone: what they took says
    nothing about steps.
    """

    def __init__(self, console: Console, budget: Budget):
        self._console, self._budget = console, budget
        self._bar: Progress | None = None
        self._last_line = -math.inf
        self._steps_left = Remaining(budget.steps) if budget.steps is not None else None
        self._stage, self._begun, self._stage_left = "", 0.0, Remaining(1)

    def __enter__(self) -> TrainingProgress:
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.fields[detail]}"),
                TimeElapsedColumn(),
                TextColumn("{task.fields[left]}"),
                console=self._console,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=1.0, detail="", left="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def stage(self, name: str, done: int, total: int) -> None:
        """Told of what takes long before the first step or between two: at its beginning, after each unit, and so at
        its end."""
        now = time.monotonic()
        if name != self._stage:
            self._stage, self._begun, self._stage_left = name, now, Remaining(total)
        self._stage_left.told(done, now)
        seconds, count = self._stage_left.seconds(), f"{done} of {total}"
        left = ESTIMATING if seconds is None else f"about {seconds:.0f} s left"
        if self._bar is not None:
            self._bar.update(self._task, description=name, completed=done / max(total, 1), detail=count, left=left)
        elif done >= total:
            self._line(now, f"{name}: {count}, {now - self._begun:.0f} s")
        elif done == 0:
            self._line(now, f"{name}: {count}")
        elif now - self._last_line >= PLAIN_EVERY:
            self._line(now, f"{name}: {count}, {left}")

    def waiting(self, name: str, seconds: float) -> None:
        """Told that something goes on which can't be counted: how long it has been is all that there is to say."""
        if self._bar is not None:
            self._bar.update(self._task, description=name, detail=f"{seconds:.0f} s", left="")
        else:
            self._line(time.monotonic(), f"{name}: {seconds:.0f} s so far")

    def trained(self) -> None:
        """Told that training is over: nothing to show, as scoring shows itself."""

    def __call__(self, step: int, loss: float, seconds: float) -> None:
        """Told after each step."""
        spent = min(share_spent(self._budget, step, seconds), 1.0)
        if self._steps_left is not None:
            self._steps_left.told(step, seconds)
        if self._bar is not None:
            self._bar.update(
                self._task,
                description="training",
                completed=spent,
                detail=f"step {step} loss {loss:.4f}",
                left=self._left(seconds),
            )
            return
        now = time.monotonic()
        if spent >= 1 or now - self._last_line >= PLAIN_EVERY:
            self._line(now, f"step {step}, loss {loss:.4f}, {seconds:.0f} s trained, {self._left(seconds)}")

    def _line(self, now: float, text: str) -> None:
        self._last_line = now
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _left(self, seconds: float) -> str:
        by_steps = None if self._steps_left is None else self._steps_left.seconds()
        if self._budget.seconds is None:
            return ESTIMATING if by_steps is None else f"about {by_steps:.0f} s left"
        limit = max(0.0, self._budget.seconds - seconds)
        if self._steps_left is not None and by_steps is None:
            return f"at most {limit:.0f} s left"
        return f"about {limit if by_steps is None else min(limit, by_steps):.0f} s left"


@contextmanager
def still_alive(report: Report, name: str, every: float = PLAIN_EVERY) -> Iterator[None]:
    """Tell `report` every so many seconds that the block goes on, for work that counts nothing: kernels compile."""
    over, begun = threading.Event(), time.monotonic()

    def tell() -> None:
        while not over.wait(every):
            report.waiting(name, time.monotonic() - begun)

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def print_result(console: Console, result: Result) -> None:
    """The scores in one table, and below it why any is missing."""
    table = Table("score", "value", title=f"{result.spec.method} on {result.spec.dataset}, {result.spec.protocol}")
    for column, value in result.scores.items():
        table.add_row(column, f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}")
    console.print(table)
    if result.role is not None:
        console.print(ROLE_SAYS[result.role], highlight=False, markup=False, soft_wrap=True)
    reasons: dict[str, list[str]] = {}
    for column, reason in result.left_out.items():
        reasons.setdefault(reason, []).append(column)
    for reason, columns in reasons.items():
        console.print(f"no {', '.join(columns)}: {reason}", highlight=False, markup=False, soft_wrap=True)
