"""The executor of this machine: jobs in spawned processes, which never outlive the process that started them."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess, parent_process
from pathlib import Path

from filelock import FileLock, Timeout

from dofbench.core.clock import loading
from dofbench.core.errors import one_line
from dofbench.core.jobs import FREED, Busy, Job, Outcome, Watcher
from dofbench.runtime.memory import machine_memory_mb
from dofbench.runtime.memory_evidence import SAMPLE_EVERY, MemoryWatch
from dofbench.runtime.supervised import recorded, report_deaths
from dofbench.runtime.threads import allowed_threads

_THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
# With it a new Python process doesn't look for modules in the current folder, where a stranger's `random.py` may be.
_SAFE_PATH = "PYTHONSAFEPATH"
_GRACE = 20.0  # s in which a job may keep what it has, by ending the step of a training
_LOOK_AGAIN = 1.0  # s
_VISIBLE = "CUDA_VISIBLE_DEVICES"  # GPUs that a process sees, numbered anew from 0


class LocalProcesses:
    """An `Executor`: each job in a process of its own on this machine, several at a time.

    A job starts when one of the `workers` is free, when it can have an accelerator for itself if it needs one, and when
    its memory fits beside that of the jobs at work, as far as their needs are known; one job always runs. An
    accelerator is a job's until the job ends or reports `FREED`; jobs of other commands don't get it either.
    memory_mb: of the machine, MB; None for what this one has. gpus: how many GPUs there are for jobs that ask for any;
    where there are several, a job sees none but its own, under the name that it asked for.

    The processes share this one's threads: each has OMP_NUM_THREADS / workers of them. When this process is
    interrupted, they get SIGTERM, and are killed a little later; when it is killed, at once: whatever they write must
    be atomic.
    """

    def __init__(self, workers: int, memory_mb: float | None = None, gpus: int = 1):
        self.at_a_time = workers
        self._gpus = gpus
        self._memory_mb = machine_memory_mb() if memory_mb is None else memory_mb

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """See `dofbench.core.jobs.Executor.run`. A job whose process is killed has that as its problem, unless it ran
        out of memory and had said what is to be recorded then."""
        waiting, outcomes = list(jobs), dict[str, Outcome]()
        running: dict[str, _Running] = {}
        workers = max(1, min(self.at_a_time, len(jobs)))
        threads = max(1, allowed_threads() // workers)
        try:
            while waiting or running:
                ready = [job for job in waiting if job.after is None or job.after in outcomes]
                for job in ready:
                    if len(running) == workers:
                        break
                    if job.busy():
                        continue
                    if message := job.done():
                        waiting.remove(job)
                        outcomes[job.name] = Outcome(job.name, message)
                        watcher.ended(outcomes[job.name])
                    elif (place := self._free_place(job, list(running.values()))) is not None:
                        waiting.remove(job)
                        variables = dict.fromkeys(_THREADS, str(threads)) | self._only(job, place.device)
                        running[job.name] = _start(job, place, variables)
                        watcher.started(job.name)
                if not running and waiting:  # all that is left, or the GPU that it needs, is another process's
                    watcher.idle(len(waiting))
                    time.sleep(_LOOK_AGAIN)
                pipes = {one.pipe: name for name, one in running.items()}
                ready_pipes = wait(list(pipes), SAMPLE_EVERY)
                for one in running.values():
                    one.memory.sample()
                for pipe in ready_pipes:
                    assert isinstance(pipe, Connection)
                    name = pipes[pipe]
                    outcome = _received(running[name], watcher)
                    if outcome is FREED:
                        running[name].place.free()
                    if outcome is None or outcome is FREED:
                        continue
                    ended = running.pop(name)
                    ended.process.join()
                    ended.place.free()
                    pipe.close()
                    if isinstance(outcome, Outcome):
                        outcomes[name] = outcome
                        watcher.ended(outcome)
                    else:
                        waiting.append(ended.job)
                        watcher.put_off(name)
        finally:
            for one in running.values():
                one.process.terminate()
            ends = time.monotonic() + _GRACE
            for one in running.values():
                one.process.join(max(0.0, ends - time.monotonic()))
                one.process.kill()
                one.process.join()
                one.place.free()
        return [outcomes[job.name] for job in jobs]

    def _free_place(self, job: Job, others: Sequence[_Running]) -> _Place | None:
        """Where the job can run beside the others; None where it can't."""
        known = [one.takes.memory_mb for one in (job, *(other.job for other in others)) if one.takes.memory_mb]
        if others and job.takes.memory_mb and sum(known) > self._memory_mb:
            return None
        if job.takes.device == "cpu":
            return _Place("cpu")
        taken = {other.place.device for other in others}
        several = job.takes.device == "cuda" and self._gpus > 1
        wanted = [f"cuda:{number}" for number in range(self._gpus)] if several else [job.takes.device]
        free = (_claimed(device) for device in wanted if device not in taken)
        return next((place for place in free if place is not None), None)

    def _only(self, job: Job, device: str) -> dict[str, str]:
        """The variable that shows a job none but the GPU that it was given."""
        if device == job.takes.device:
            return {}
        return {_VISIBLE: _number(device)}


@dataclass
class _Place:
    """A device, "" once it is free again, and the lock that keeps other commands of this machine from a GPU."""

    device: str
    lock: FileLock | None = None

    def free(self) -> None:
        self.device = ""
        if self.lock is not None:
            self.lock.release()


def _claimed(device: str) -> _Place | None:
    """The accelerator, for this command alone; None while another command has it."""
    if not device.startswith("cuda"):
        return _Place(device)
    # A file of all users, which stays.
    lock = FileLock(Path(tempfile.gettempdir()) / f"dofbench-gpu-{_number(device)}.lock", mode=0o666)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return _Place(device, lock)


def _number(device: str) -> str:
    """The GPU's number or name on this machine. device: as torch names it here, by its place among the visible ones."""
    visible = os.environ.get(_VISIBLE, "").split(",")
    number = int(device.partition(":")[2] or 0)
    return visible[number].strip() if number < len(visible) and visible != [""] else str(number)


@dataclass(frozen=True)
class _Running:
    job: Job
    place: _Place
    process: BaseProcess
    pipe: Connection
    memory: MemoryWatch
    on_death: list[bytes | None] = field(default_factory=lambda: [None])  # the last one counts


def _start(job: Job, place: _Place, variables: dict[str, str]) -> _Running:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(
        target=_work,
        args=(pickle.dumps(job.work), theirs, os.environ.get(_SAFE_PATH)),
        name=job.name,
    )
    with _environment(variables | {_SAFE_PATH: "1"}):
        process.start()
    # The child has its own copy. Once ours is closed, the pipe ends when the child does.
    theirs.close()
    assert process.pid is not None
    return _Running(job, place, process, ours, MemoryWatch(process.pid))


def _received(run: _Running, watcher: Watcher) -> Outcome | tuple[str, int, int] | type[Busy] | None:
    """What the pipe has to say: the outcome, `Busy`, or after a report, which the watcher is told, None or `FREED`."""
    name = run.job.name
    try:
        kind, content = run.pipe.recv()
    except EOFError:
        run.process.join()
        code = run.process.exitcode or 0
        line, done = recorded(run.on_death[-1], run.memory, -code) if code < 0 else ("", False)
        if line:
            return Outcome(name, message=line) if done else Outcome(name, problem=line)
        how = f"killed by signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"ended with status {code}"
        return Outcome(name, problem=f"its process was {how}")
    if kind == "on death":
        run.on_death.append(content)
        return None
    if kind == "report":
        watcher.reported(name, content)
        return FREED if content == FREED else None
    return Busy if kind == "busy" else Outcome(name, **{kind: content})


def _work(pickled: bytes, pipe: Connection, safe_path: str | None) -> None:
    """The process's main function; what it needs is imported as the work is unpickled.

    safe_path: the variable of that name as it was before the process was started, for commands that the work starts.
    """
    os.environ.pop(_SAFE_PATH)
    if safe_path is not None:
        os.environ[_SAFE_PATH] = safe_path
    # Ctrl-C reaches every process of the terminal; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    report_deaths(lambda action: pipe.send(("on death", action)))
    try:
        try:
            with loading.running():
                work = pickle.loads(pickled)
            pipe.send(("message", work(lambda report: pipe.send(("report", report)))))
        except BrokenPipeError:
            raise
        except Busy:
            pipe.send(("busy", ""))
        except KeyboardInterrupt:
            pipe.send(("problem", "interrupted"))
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
