"""Jobs: independent pieces of work, the resources that each needs, and the interface of executors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

Report = Callable[[Any], None]


class Busy(Exception):
    """Raised by a job's work that finds another process at the same: the job is left until others are done."""


# The report of a job that no longer needs its accelerator for itself: the executor may give it to another job.
FREED = ("trained", 0, 0)


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Resources:
    """The resources that a job needs.

    device: as torch names it; "cuda" is any GPU, "cuda:1" that one. memory_mb: peak of resident memory, MB; None if
    unknown. seconds: wall time; None if unknown.
    """

    device: str = "cpu"
    memory_mb: float | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Job:
    """A piece of work that can be done in another process or on another machine.

    work: called with a function that sends a report; its return value is the outcome's message. The function and its
    reports must be picklable. after: the name of a job that must have ended before, successfully or not. busy: whether
    the job should be postponed at present. insist: called instead of `work` when all remaining jobs are busy; it waits
    for the other process instead of raising `Busy`.
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
    """Notified of the progress of jobs."""

    def started(self, name: str) -> None:
        """The job has started."""

    def reported(self, name: str, report: Any) -> None:
        """The job sent a report."""

    def put_off(self, name: str) -> None:
        """The job was started and has been postponed."""

    def ended(self, outcome: Outcome) -> None:
        """The job ended, successfully or not."""


class Executor(Protocol):
    """Carries out jobs, for example in this process, in processes of this machine, or on a cluster."""

    @property
    def at_a_time(self) -> int:
        """The largest number of jobs at the same time."""

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """Carry out the jobs and return their outcomes in the order of the jobs.

        A job that fails doesn't stop the others. When the call is interrupted, all jobs are stopped.
        """


class ThisProcess:
    """Carries out jobs one after another in the calling process. An error in a job, or Ctrl-C, is raised to the caller;
    meant for a single job."""

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
