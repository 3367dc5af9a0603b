"""Jobs: independent pieces of work, what each takes of a machine, and who may do them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

Report = Callable[[Any], None]


class Busy(Exception):
    """Raised by a job's work that finds another process at the same: the job is left until others are done."""


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Resources:
    """What a job takes of the machine that does it.

    device: what it computes on, as torch names it. memory_mb: its peak of resident memory, MB; None where nobody knows.
    seconds: wall time; None where nobody knows.
    """

    device: str = "cpu"
    memory_mb: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Job:
    """Something to do, if need be in a process of its own or on another machine.

    work: called with a function that sends a report; what it returns is the outcome's message. It must be possible to
    pickle it, and its reports. after: the name of a job that must have ended, well or not, before. busy: whether it had
    better be left for later, as things are now. insist: called in place of `work` when all that is left is busy; it
    waits for the other process instead of raising `Busy`.
    """

    name: str
    work: Callable[[Report], str]
    after: str | None = None
    busy: Callable[[], bool] = _never
    takes: Resources = Resources()
    insist: Callable[[Report], str] | None = None


@dataclass(frozen=True)
class Outcome:
    """How a job ended. problem: empty if it did its work; else one line, or a traceback if it is a bug."""

    name: str
    message: str = ""
    problem: str = ""


class Watcher(Protocol):
    """Told what the jobs do."""

    def started(self, name: str) -> None:
        """The job is being done."""

    def reported(self, name: str, report: Any) -> None:
        """The job sent a report."""

    def put_off(self, name: str) -> None:
        """The job was begun and is left for later."""

    def ended(self, outcome: Outcome) -> None:
        """The job ended, well or not."""


class Executor(Protocol):
    """Does jobs somewhere: in this process, in processes of this machine, on a cluster."""

    @property
    def at_a_time(self) -> int:
        """How many jobs it does at a time, at most."""

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """Do the jobs and return their outcomes in the order given.

        A job that fails doesn't stop the others. When the call is interrupted, no job goes on.
        """


class ThisProcess:
    """Does jobs one after another in the process that asks for them. An error in one ends the call and goes to the
    caller, as does Ctrl-C: for a single job, whose end is the call's."""

    at_a_time = 1

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """See `Executor.run`."""
        outcomes = []
        for job in jobs:
            watcher.started(job.name)

            def report(content: Any, name: str = job.name) -> None:
                watcher.reported(name, content)

            outcomes.append(Outcome(job.name, job.work(report)))
            watcher.ended(outcomes[-1])
        return outcomes
