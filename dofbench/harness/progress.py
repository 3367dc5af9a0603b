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
from dofbench.remaining import ESTIMATING, Remaining

PLAIN_EVERY = 10.0  # seconds between two plain lines: a log stays readable, and shows that it is alive


class TrainingProgress:
    """Shows step, loss and the time left; before the first step, the stages that lead to it and what is left of each.

    The time left is that of what is shown, by its own rate: a stage says nothing about how long steps take.
    """

    def __init__(self, console: Console, budget: Budget, now: Callable[[], float] | None = None):
        self._console, self._budget, self._now = console, budget, now or time.monotonic
        self._bar: Progress | None = None
        self._last_line = -math.inf
        self._stage: tuple[str, float] | None = None  # name and when it began
        self._stage_left = Remaining(1)
        self._steps_left = self._of_steps()

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
            self._stage, self._stage_left = (name, now), Remaining(total)
        self._stage_left.told(done, now)
        left = _about(self._stage_left.seconds())
        count = f"{done} of {total}"
        if self._bar is not None:
            self._bar.update(self._task, description=name, completed=done / max(total, 1), detail=count,
                             left=left)
            return
        if done >= total:
            self._line(now, f"{name}: {count}, {now - self._stage[1]:.0f} s")
        elif done == 0 or now - self._last_line >= PLAIN_EVERY:
            self._line(now, f"{name}: {count}, {left}" if done else f"{name}: {count}")

    def __call__(self, step: int, loss: float, seconds: float) -> None:
        """Told after each step."""
        if self._stage is not None or step == 1:
            self._stage, self._steps_left = None, self._of_steps()
        spent = min(share_spent(self._budget, step, seconds), 1.0)
        if self._steps_left is not None:
            self._steps_left.told(step, seconds)
        if self._bar is not None:
            self._bar.update(self._task, description="training", completed=spent, detail=f"step {step} loss {loss:.4f}",
                             left=self._left(seconds))
            return
        now = self._now()
        if spent >= 1 or now - self._last_line >= PLAIN_EVERY:
            self._line(now, f"step {step}, loss {loss:.4f}, {seconds:.0f} s trained, {self._left(seconds)}")

    def _line(self, now: float, text: str) -> None:
        self._last_line = now
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _of_steps(self) -> Remaining | None:
        return None if self._budget.steps is None else Remaining(self._budget.steps)

    def _left(self, seconds: float) -> str:
        by_steps = None if self._steps_left is None else self._steps_left.seconds()
        if self._budget.seconds is None:
            return _about(by_steps)
        limit = max(0.0, self._budget.seconds - seconds)
        if self._steps_left is not None and by_steps is None:
            return f"at most {limit:.0f} s left"
        return f"about {limit if by_steps is None else min(limit, by_steps):.0f} s left"


def _about(seconds: float | None) -> str:
    return ESTIMATING if seconds is None else f"about {seconds:.0f} s left"


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
