"""What the terminal shows of a result: decisions of the training, scores, reasons for missing ones."""

from __future__ import annotations

import shlex

from rich.console import Console
from rich.table import Table

from dofbench.core.evidence import ROLE_SAYS
from dofbench.core.progress import say
from dofbench.evaluation.results.result import Result
from dofbench.running.data_plan import decided
from dofbench.running.plan import Plan
from dofbench.running.training_log import LOG_FOLDER


def show_cached(console: Console, plan: Plan, result: Result) -> None:
    """Show a result that an earlier call has finished."""
    say(console, f"using the cached result (--rerun trains again): {plan.folder}")
    show_result(console, plan, result)
    if plan.settings.log is not None and not (plan.folder / LOG_FOLDER).is_dir():
        say(console, "no log of the cached result; --rerun trains again")
    else:
        show_log(console, plan)


def show_log(console: Console, plan: Plan) -> None:
    """Show the command that opens the run's log, if one was asked for."""
    if plan.settings.log is not None:
        say(console, f"log    tensorboard --logdir {shlex.quote(str(plan.folder / LOG_FOLDER))}")


def show_result(console: Console, plan: Plan, result: Result) -> None:
    """Show the decisions that training made, and the scores with the reason for each one that is missing."""
    for line in decided(plan.by_data.stages, result.plan):
        say(console, line)
    table = Table("score", "value", title=f"{result.spec.method} on {result.spec.dataset}, {result.spec.protocol}")
    for column, value in result.scores.items():
        table.add_row(column, f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}")
    console.print(table)
    if result.role is not None:
        say(console, ROLE_SAYS[result.role])
    if result.no_ranking:
        say(console, f"this dataset can't rank lenses: {result.no_ranking}")
    reasons: dict[str, list[str]] = {}
    for column, reason in result.left_out.items():
        reasons.setdefault(reason, []).append(column)
    for reason, columns in reasons.items():
        say(console, f"no {', '.join(columns)}: {reason}")
