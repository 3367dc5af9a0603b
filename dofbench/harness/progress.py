"""What a run says on the terminal: a bar where there is a terminal, plain lines where there is none."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from dofbench.contracts import Budget
from dofbench.harness.observer import share_spent
from dofbench.harness.result import Result

PLAIN_EVERY = 10.0  # seconds between two plain lines: a log stays readable, and shows that it is alive


class TrainingProgress:
    """Shows step, loss and the time left, estimated from the share of the budget that is spent."""

    def __init__(self, console: Console, budget: Budget):
        self._console, self._budget = console, budget
        self._bar: Progress | None = None
        self._last_line = 0.0

    def __enter__(self) -> TrainingProgress:
        if self._console.is_terminal:
            self._bar = Progress(
                TextColumn("training"), BarColumn(), TextColumn("step {task.fields[step]} loss {task.fields[loss]}"),
                TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=self._console,
            )
            self._bar.start()
            self._task = self._bar.add_task("training", total=1.0, step=0, loss="-")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, step: int, loss: float, seconds: float) -> None:
        """Told after each step."""
        spent = min(share_spent(self._budget, step, seconds), 1.0)
        if self._bar is not None:
            self._bar.update(self._task, completed=spent, step=step, loss=f"{loss:.4f}")
            return
        now = time.monotonic()
        if spent >= 1 or now - self._last_line >= PLAIN_EVERY:
            self._last_line = now
            left = seconds * (1 - spent) / spent
            self._console.print(f"step {step}, loss {loss:.4f}, {seconds:.0f} s trained, about {left:.0f} s left",
                                highlight=False)


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
