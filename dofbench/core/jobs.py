"""Jobs: independent pieces of work, the resources that each needs, and the interface of executors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from dofbench.core.errors import Status

Report = Callable[[Any], None]


class Busy(Exception):
    """Raised by a job's work that finds another process at the same: the job is left until that one is done."""


# The report of a job that no longer needs its accelerator for itself: the executor may give it to another job.
FREED = ("trained", 0, 0)


def _never() -> bool:
    return False


def _not_yet() -> str:
    return ""


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
    another process has the job at work. done: the outcome's message where another process has done it since, else "".
    """

    name: str
    work: Callable[[Report], str]
    after: str | None = None
    busy: Callable[[], bool] = _never
    done: Callable[[], str] = _not_yet
    takes: Resources = Resources()


@dataclass(frozen=True)
class Outcome:
    """How a job ended; true when nothing failed.

    name: the job's. message: one line about its end. problem: empty if it did its work; else one line, or a traceback
    if it is a bug. Of a run also: folder, where its result is; status, None for a dry run; reused, whether a finished
    result of the same key was there already.
    """

    name: str
    message: str = ""
    problem: str = ""
    folder: Path = Path()
    status: Status | None = None
    reused: bool = False

    def __bool__(self) -> bool:
        return not self.problem and self.status in (None, Status.OK)


class Watcher:
    """Notified of the progress of jobs; this base does nothing."""

    def started(self, name: str) -> None:
        """The job has started."""

    def reported(self, name: str, report: Any) -> None:
        """The job sent a report."""

    def put_off(self, name: str) -> None:
        """The job was started and has been postponed."""

    def idle(self, waiting: int) -> None:
        """So many jobs wait for other processes to finish, and none is at work; told again and again."""

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
