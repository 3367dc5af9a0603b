"""What a run says on the terminal: a bar where there is a terminal, plain lines where there is none."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from dofbench.contracts import Budget
from dofbench.harness.observer import share_spent
from dofbench.harness.result import Result
from dofbench.remaining import Remaining

PLAIN_EVERY = 10.0  # seconds between two plain lines: a log stays readable, and shows that it is alive


class TrainingProgress:
    """Shows step, loss and the time left; before the first step, the stages that lead to it and what is left of each.

    The time left is that of what is shown, by its own rate: a stage says nothing about how long steps take.
    """

    def __init__(self, console: Console, budget: Budget, now: Callable[[], float] = time.monotonic):
        self._console, self._budget, self._now = console, budget, now
        self._bar: Progress | None = None
        self._last_line = -math.inf
        self._stage: tuple[str, float] | None = None  # name and when it began
        self._remaining = Remaining()

    def __enter__(self) -> TrainingProgress:
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[detail]}"),
                TimeElapsedColumn(), TextColumn("{task.fields[left]}"), console=self._console,
            )
            self._bar.start()
            self._task = self._bar.add_task("training", total=1.0, detail="", left="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def stage(self, name: str, done: int, total: int) -> None:
        """Told of what comes before the first step."""
        now = self._now()
        if self._stage is None or self._stage[0] != name:
            self._stage, self._remaining = (name, now), Remaining()
        left = self._remaining(done, total, now)
        count = f"{done} of {total}"
        if self._bar is not None:
            self._bar.update(self._task, description=name, completed=done / max(total, 1), detail=count,
                             left=_left(left))
            return
        if done >= total:
            self._line(now, f"{name}: {count}, {now - self._stage[1]:.0f} s")
        elif done == 0 or now - self._last_line >= PLAIN_EVERY:
            self._line(now, ", ".join([f"{name}: {count}", *([_left(left)] if left is not None else [])]))

    def __call__(self, step: int, loss: float, seconds: float) -> None:
        """Told after each step."""
        if self._stage is not None or step == 1:
            self._stage, self._remaining = None, Remaining()
        spent = min(share_spent(self._budget, step, seconds), 1.0)
        limits = []
        if self._budget.steps is not None:
            limits.append(self._remaining(step, self._budget.steps, seconds))
        if self._budget.seconds is not None:
            limits.append(max(self._budget.seconds - seconds, 0.0))
        left = min((limit for limit in limits if limit is not None), default=None)
        if self._bar is not None:
            self._bar.update(self._task, description="training", completed=spent, detail=f"step {step} loss {loss:.4f}",
                             left=_left(left))
            return
        now = self._now()
        if spent >= 1 or now - self._last_line >= PLAIN_EVERY:
            parts = [f"step {step}, loss {loss:.4f}, {seconds:.0f} s trained"]
            self._line(now, ", ".join(parts + ([_left(left)] if left is not None else [])))

    def _line(self, now: float, text: str) -> None:
        self._last_line = now
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)


def _left(seconds: float | None) -> str:
    return "" if seconds is None else f"about {seconds:.0f} s left"


def print_result(console: Console, result: Result) -> None:
    """The scores in one table, and below it why any is missing."""
    table = Table("score", "value", title=f"{result.spec.method} on {result.spec.dataset}, {result.spec.protocol}")
    for column, value in result.scores.items():
        table.add_row(column, f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}")
    console.print(table)
    reasons: dict[str, list[str]] = {}
    for column, reason in result.left_out.items():
        reasons.setdefault(reason, []).append(column)
    for reason, columns in reasons.items():
        console.print(f"no {', '.join(columns)}: {reason}", highlight=False, markup=False, soft_wrap=True)
