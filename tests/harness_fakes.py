"""Stand-ins for what runs jobs and for what shows their progress, for the tests of the harness."""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import partial

from rich.console import Console

from dofbench.core.errors import one_line
from dofbench.core.jobs import Job, Outcome, Watcher


class Here:
    """An executor in this process, where the fakes are. `fatal` ends the call at the n-th, as if it were killed."""

    at_a_time = 1

    def __init__(self, fatal: int | None = None):
        self.made: list[str] = []
        self.fatal = fatal

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """Do them one after another; one that fails doesn't stop the others."""
        outcomes = []
        for job in jobs:
            if self.fatal is not None and len(self.made) == self.fatal:
                raise KeyboardInterrupt
            self.made.append(job.name)
            watcher.started(job.name)
            try:
                outcome = Outcome(job.name, job.work(partial(watcher.reported, job.name)))
            except Exception as error:
                outcome = Outcome(job.name, problem=one_line(error) or repr(error))
            watcher.ended(outcome)
            outcomes.append(outcome)
        return outcomes


def text_console() -> tuple[Console, io.StringIO]:
    """A console without colours, and what is said on it."""
    stream = io.StringIO()
    return Console(file=stream, width=200), stream
