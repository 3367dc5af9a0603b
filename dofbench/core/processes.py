"""The executor of this machine: jobs in spawned processes, which never outlive the process that started them."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess, parent_process
from pathlib import Path

from dofbench.core.clock import loading
from dofbench.core.errors import one_line
from dofbench.core.jobs import Busy, Job, Outcome, Watcher

_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")


class LocalProcesses:
    """An `Executor`: each job in a process of its own on this machine, several at a time.

    A job starts when one of the `workers` is free, when no other job has its accelerator, and when its memory fits
    beside that of the jobs at work, as far as their needs are known; one job always runs. memory_mb: of the machine,
    MB; None for what this one has.

    The processes share this one's threads: each has OMP_NUM_THREADS / workers of them. When this process ends, however,
    they are killed: whatever they write must be atomic.
    """

    def __init__(self, workers: int, memory_mb: float | None = None):
        self.at_a_time = workers
        self._memory_mb = machine_memory_mb() if memory_mb is None else memory_mb

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """See `dofbench.core.jobs.Executor.run`. A job whose process is killed has that as its problem."""
        waiting, outcomes = list(jobs), {}
        found_busy: set[str] = set()
        running: dict[str, _Running] = {}
        workers = max(1, min(self.at_a_time, len(jobs)))
        threads = max(1, int(os.environ.get("OMP_NUM_THREADS", "1").split(",")[0]) // workers)
        try:
            while waiting or running:
                ready = [job for job in waiting if job.after is None or job.after in outcomes]
                if len(running) < workers:
                    busy = {job.name: job.name in found_busy or job.busy() for job in ready}
                    for job in sorted(ready, key=lambda job: busy[job.name]):
                        if len(running) < workers and self._fits(job, [one.job for one in running.values()]):
                            waiting.remove(job)
                            running[job.name] = _start(job, threads, insist=busy[job.name])
                            watcher.started(job.name)
                pipes = {one.pipe: name for name, one in running.items()}
                for pipe in wait(list(pipes)):
                    assert isinstance(pipe, Connection)
                    name = pipes[pipe]
                    outcome = _received(running[name], watcher)
                    if outcome is None:
                        continue
                    ended = running.pop(name)
                    ended.process.join()
                    pipe.close()
                    if isinstance(outcome, Outcome):
                        outcomes[name] = outcome
                        watcher.ended(outcome)
                    else:
                        found_busy.add(name)
                        waiting.append(ended.job)
                        watcher.put_off(name)
        finally:
            for one in running.values():
                one.process.kill()
                one.process.join()
        return [outcomes[job.name] for job in jobs]

    def _fits(self, job: Job, others: Sequence[Job]) -> bool:
        """Whether the machine can do the job beside the others."""
        if not others:
            return True
        if job.takes.device != "cpu" and any(other.takes.device == job.takes.device for other in others):
            return False
        known = [one.takes.memory_mb for one in (job, *others) if one.takes.memory_mb is not None]
        return job.takes.memory_mb is None or sum(known) <= self._memory_mb


def machine_memory_mb(cgroup: Path = Path("/sys/fs/cgroup")) -> float:
    """Memory that processes here may use, MB: the machine's, or the container's where that is less."""
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        with suppress(OSError, ValueError):  # no Linux, no such cgroup, or "max"
            limits.append(int((cgroup / name).read_text()))
    return min(limits) / 1e6


@dataclass(frozen=True)
class _Running:
    job: Job
    process: BaseProcess
    pipe: Connection


def _start(job: Job, threads: int, *, insist: bool) -> _Running:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(
        target=_work, args=(pickle.dumps(job.insist if insist and job.insist else job.work), theirs), name=job.name
    )
    with _environment(dict.fromkeys(_THREADS, str(threads))):
        process.start()
    # The child has its own copy. Once ours is closed, the pipe ends when the child does.
    theirs.close()
    return _Running(job, process, ours)


def _received(run: _Running, watcher: Watcher) -> Outcome | type[Busy] | None:
    """What the pipe has to say: the outcome, `Busy`, or None after a report."""
    name = run.job.name
    try:
        kind, content = run.pipe.recv()
    except EOFError:
        run.process.join()
        code = run.process.exitcode or 0
        how = f"killed by signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"ended with status {code}"
        return Outcome(name, problem=f"its process was {how}")
    if kind == "report":
        watcher.reported(name, content)
        return None
    return Busy if kind == "busy" else Outcome(name, **{kind: content})


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
        except Busy:
            pipe.send(("busy", ""))
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
