"""Independent jobs in spawned processes that report what they do, and never outlive the process that started them."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess, parent_process
from typing import Any, Protocol

from dofbench.core.clock import loading
from dofbench.core.errors import one_line

Report = Callable[[Any], None]
_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Job:
    """Something to do in a process of its own.

    work: called with a function that sends a report; what it returns is the outcome's message. It travels to the
    process by pickle, and so do reports. after: the name of a job that must have ended, well or not, before. busy:
    whether it had better be left for later, as things are now.
    """

    name: str
    work: Callable[[Report], str]
    after: str | None = None
    busy: Callable[[], bool] = _never


@dataclass(frozen=True)
class Outcome:
    """How a job ended. problem: empty if it did its work; else one line, or a traceback if it is a bug."""

    name: str
    message: str = ""
    problem: str = ""


class Watcher(Protocol):
    """Told what the jobs do."""

    def started(self, name: str) -> None:
        """The job's process runs."""

    def reported(self, name: str, report: Any) -> None:
        """The job sent a report."""

    def ended(self, outcome: Outcome) -> None:
        """The job ended, well or not."""


def run_jobs(jobs: Sequence[Job], *, workers: int, watcher: Watcher) -> list[Outcome]:
    """Do the jobs, at most `workers` at a time, and return their outcomes in the order given.

    A job that fails, or whose process is killed, doesn't stop the others. The processes share this one's threads:
    each has OMP_NUM_THREADS / workers of them. When this process ends, however, they are killed: whatever
    they write must be atomic.
    """
    waiting, outcomes = list(jobs), {}
    running: dict[str, tuple[BaseProcess, Connection]] = {}
    threads = max(1, int(os.environ.get("OMP_NUM_THREADS", "1").split(",")[0]) // workers)
    try:
        while waiting or running:
            ready = [job for job in waiting if job.after is None or job.after in outcomes]
            free = workers - len(running)
            for job in sorted(ready, key=lambda job: job.busy())[:free] if free else ():
                waiting.remove(job)
                running[job.name] = _start(job, threads)
                watcher.started(job.name)
            pipes = {pipe: name for name, (_, pipe) in running.items()}
            for pipe in wait(list(pipes)):
                assert isinstance(pipe, Connection)
                name = pipes[pipe]
                outcome = _received(name, running[name], watcher)
                if outcome is not None:
                    process, _ = running.pop(name)
                    process.join()
                    pipe.close()
                    outcomes[name] = outcome
                    watcher.ended(outcome)
    finally:
        for process, _ in running.values():
            process.kill()
            process.join()
    return [outcomes[job.name] for job in jobs]


def _start(job: Job, threads: int) -> tuple[BaseProcess, Connection]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(pickle.dumps(job.work), theirs), name=job.name)
    with _environment(dict.fromkeys(_THREADS, str(threads))):
        process.start()
    # The child has its own copy. Once ours is closed, the pipe ends when the child does.
    theirs.close()
    return process, ours


def _received(name: str, run: tuple[BaseProcess, Connection], watcher: Watcher) -> Outcome | None:
    """What the pipe has to say: the outcome, or None after a report."""
    process, pipe = run
    try:
        kind, content = pipe.recv()
    except EOFError:
        process.join()
        code = process.exitcode or 0
        how = f"killed by signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"ended with status {code}"
        return Outcome(name, problem=f"its process was {how}")
    if kind == "report":
        watcher.reported(name, content)
        return None
    return Outcome(name, **{kind: content})


def _work(pickled: bytes, pipe: Connection) -> None:
    """The process's main function; what it needs is imported as the work is unpickled."""
    # Ctrl-C reaches every process of the terminal; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        try:
            with loading.running():
                work = pickle.loads(pickled)
            pipe.send(("message", work(lambda report: pipe.send(("report", report)))))
        except BrokenPipeError:
            raise
        except Exception as error:
            pipe.send(("problem", one_line(error) or traceback.format_exc()))
        pipe.close()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        # Ends without the interpreter's clean-up, for the reason that `cli.console` gives.
        os._exit(0)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Set variables for the processes started meanwhile."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
