"""Jobs on a cluster by Slurm, through submitit: an executor that may be killed, and of which several may be at once.

For each job there is a record, a file that only one process can create, with the number that Slurm gave it. Who finds
one follows that job instead of submitting it again. A job that ends without an answer (a node that vanished, SIGKILL, a
lack of memory) is submitted again; a training then goes on from its checkpoint. Before a time limit or a preemption
Slurm sends SIGUSR2: the training is kept, and the job queued again.
"""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

from dofbench.core.errors import InputError, one_line
from dofbench.core.files import write_json
from dofbench.core.jobs import FREED, Busy, Job, Outcome, Report, Watcher

MEMORY, TIME = 1.3, 3.0  # of what is expected
LEAST_MB, LEAST_MINUTES = 4000.0, 30
_UNKNOWN_MB, _UNKNOWN_S = 16_000.0, 4 * 3600.0
TRIES = 3  # of a job that dies
_POLL = 2.0  # s between two looks at the queue
_UNLISTED = 15.0  # s that a new job may be unknown to the queue, or an answer under way on a network's disk
_SEEN = 60.0  # s after which an answer is one that nobody waits for
_SUBMITTING = 120.0  # s after which a record without a number is of a client that died
_REPORTED_EVERY = 2.0  # s
_LIMITS = 1000  # times that a job may be queued again


@dataclass
class _Submitted:
    """A job in Slurm's hands. number: Slurm's. missing: since when it has been unknown to the queue; None while it is
    known."""

    job: Job
    number: str
    tries: int
    missing: float | None = None
    running: bool = False
    said: str = ""


class Slurm:
    """An `Executor`: each job is one of Slurm's, with the memory, time and GPU that it needs.

    folder: of records, logs and answers, on a disk that all nodes have. parameters: of sbatch, by submitit's names
    (partition, account, qos, cpus_per_task, ...); those given here win over what the jobs need. At most
    `array_parallelism` jobs (1000) are in Slurm's hands at a time. When the call is interrupted, the jobs go on. Raises
    InputError where no job can be submitted from, and for an unknown parameter.
    """

    def __init__(self, folder: Path, parameters: Mapping[str, Any]):
        try:
            import submitit
        except ImportError:
            raise InputError("--on slurm", "no package submitit", "pip install dofbench[slurm]") from None
        missing = [name for name in ("sbatch", "squeue", "srun") if shutil.which(name) is None]
        if missing:
            raise InputError("--on slurm", f"no {missing[0]}", "a machine from which jobs can be submitted")
        self._folder, self._parameters = folder.resolve(), dict(parameters)
        self._records = self._folder / "records"
        self._submitit = submitit.SlurmExecutor(folder=self._folder / "jobs", max_num_timeout=_LIMITS)
        try:
            self._submitit.update_parameters(**self._parameters)
        except ValueError as error:
            raise InputError("--slurm", str(error).splitlines()[0], "sbatch's options, by submitit's names") from None
        self.at_a_time = int(self._parameters.get("array_parallelism", _LIMITS))

    def run(self, jobs: Sequence[Job], watcher: Watcher) -> list[Outcome]:
        """See `dofbench.core.jobs.Executor.run`."""
        self._records.mkdir(parents=True, exist_ok=True)
        waiting, outcomes = list(jobs), dict[str, Outcome]()
        queued: dict[str, _Submitted] = {}

        def ended(job: Job, outcome: Outcome) -> None:
            outcomes[job.name] = outcome
            self._record(job).unlink(missing_ok=True)
            watcher.ended(outcome)

        while waiting or queued:
            ready = [job for job in waiting if job.after is None or job.after in outcomes]
            for job in ready:
                if len(queued) >= self.at_a_time:
                    break
                if (message := job.done()) and job.name not in queued:
                    waiting.remove(job)
                    ended(job, Outcome(job.name, message))
                    continue
                one = self._taken_over(job)
                if one is None and not job.busy():
                    one = self._submit(job, tries=1)
                if one is not None:
                    waiting.remove(job)
                    queued[job.name] = one
            states = self._states()
            for name, one in list(queued.items()):
                outcome = self._followed(one, states, watcher)
                if outcome is None:
                    continue
                del queued[name]
                if outcome == "again":
                    waiting.append(one.job)
                elif isinstance(outcome, _Submitted):
                    queued[name] = outcome
                else:
                    assert isinstance(outcome, Outcome)
                    ended(one.job, outcome)
            if waiting or queued:
                time.sleep(_POLL)
        self._tidy()
        return [outcomes[job.name] for job in jobs]

    def _tidy(self) -> None:
        """Remove what is left of jobs that ended while no command followed them: a good one has left its result, any
        other one is submitted again when it is asked for."""
        for file in self._records.glob("*.json"):
            with suppress(OSError, ValueError):
                number = json.loads(file.read_text(encoding="utf-8") or "{}").get("number")
                # A command that follows the job has seen its answer by then.
                if number is not None and time.time() - self._paths(number).result_pickle.stat().st_mtime > _SEEN:
                    self._answer(number)
                    file.unlink(missing_ok=True)

    def _followed(
        self, one: _Submitted, states: Mapping[str, str] | None, watcher: Watcher
    ) -> Outcome | _Submitted | str | None:
        """What became of a job: its outcome, "again" where it met another process, its successor where it died; None
        while it goes on."""
        if states is not None and states.get(one.number) == "PENDING":
            one.missing = None
            self._show(one, "PENDING", watcher)
            return None
        answer = self._answer(one.number)
        if answer is not None:
            kind, text = answer
            if kind == "busy":
                self._record(one.job).unlink(missing_ok=True)
                return "again"
            return Outcome(one.job.name, text) if kind == "message" else Outcome(one.job.name, problem=text)
        self._show(one, "" if states is None else states.get(one.number, ""), watcher)
        if states is None or one.number in states:
            one.missing = None
            return None
        now = time.monotonic()
        one.missing = one.missing or now
        if now - one.missing < _UNLISTED:
            return None
        if message := one.job.done():
            return Outcome(one.job.name, message)
        if one.tries < TRIES:
            self._record(one.job).unlink(missing_ok=True)
            return self._submit(one.job, one.tries + 1) or "again"
        return Outcome(one.job.name, problem=f"died {TRIES} times as Slurm's job {one.number}: {self._tail(one)}")

    def _show(self, one: _Submitted, state: str, watcher: Watcher) -> None:
        running = state == "RUNNING"
        if running and not one.running:
            watcher.started(one.job.name)
        elif one.running and state and not running:
            watcher.put_off(one.job.name)
        one.running = running or (one.running and not state)
        if one.running:
            with suppress(OSError, ValueError):
                said = self._progress(one.job).read_text(encoding="utf-8")
                if said != one.said:
                    one.said = said
                    watcher.reported(one.job.name, tuple(json.loads(said)))

    def _taken_over(self, job: Job) -> _Submitted | None:
        """The job as another process, or this command before, has submitted it; None where none has."""
        file = self._record(job)
        try:
            note = json.loads(file.read_text(encoding="utf-8") or "{}")
            age = time.time() - file.stat().st_mtime
        except FileNotFoundError:
            return None
        if "number" in note:
            return _Submitted(job, note["number"], note["tries"])
        if age > _SUBMITTING:
            file.unlink(missing_ok=True)
        return None

    def _submit(self, job: Job, tries: int) -> _Submitted | None:
        """Give the job to Slurm; None while another process is just doing so. Raises InputError where Slurm refuses
        it."""
        file = self._record(job)
        try:
            os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        except FileExistsError:
            return None
        try:
            self._submitit.update_parameters(**self._needs(job), **self._parameters)
            number = str(self._submitit.submit(_OnNode(job.work, self._progress(job))).job_id)
        except Exception as error:
            file.unlink(missing_ok=True)
            if type(error).__name__ == "FailedJobError" or isinstance(error, subprocess.CalledProcessError):
                raise InputError("sbatch", " ".join(str(error).split())[-300:], "a job that it takes") from None
            raise
        write_json(file, {"number": number, "tries": tries, "name": job.name})
        self._unlink_script(number)
        return _Submitted(job, number, tries)

    def _unlink_script(self, number: str) -> None:
        """Remove submitit's second name of the job's script, which it leaves."""
        for link in (self._folder / "jobs").glob(".submission_file_*"):
            with suppress(OSError):
                if link.samefile(self._paths(number).submission_file):
                    link.unlink()

    def _needs(self, job: Job) -> dict[str, Any]:
        """Of sbatch, less what the user has said."""
        memory, seconds = job.takes.memory_mb or _UNKNOWN_MB / MEMORY, job.takes.seconds or _UNKNOWN_S / TIME
        threads = int(self._parameters.get("cpus_per_task", 2))
        needs: dict[str, Any] = {
            "job_name": f"dofbench {job.name}",
            "mem": f"{max(LEAST_MB, MEMORY * memory):.0f}MB",
            "time": max(LEAST_MINUTES, round(TIME * seconds / 60)),
            "cpus_per_task": threads,
            "setup": [f"export OMP_NUM_THREADS={threads} NUMBA_NUM_THREADS={threads}"],
            "additional_parameters": {"requeue": True},
        }
        if job.takes.device.startswith("cuda"):
            needs["gpus_per_node"] = 1
        return {name: value for name, value in needs.items() if name not in self._parameters}

    def _states(self) -> dict[str, str] | None:
        """Slurm's number of each job of this user that isn't over -> its state; None where Slurm doesn't answer. squeue
        is everywhere, sacct only where jobs are accounted for."""
        asked = ["squeue", "--noheader", "--array", "--me", "--format=%i %T"]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            return None
        return dict(line.split(maxsplit=1) for line in done.stdout.splitlines() if line.strip())

    def _answer(self, number: str) -> tuple[str, str] | None:
        """What the job answered, None where it hasn't; its files are removed unless a bug ended it."""
        paths = self._paths(number)
        file = paths.result_pickle
        try:
            how, content = pickle.loads(file.read_bytes())
        except (FileNotFoundError, EOFError, pickle.UnpicklingError):
            return None
        if how == "success":
            for left in (paths.submission_file, paths.submitted_pickle, file, paths.stdout, paths.stderr):
                left.unlink(missing_ok=True)
            return content
        return "problem", str(content)

    def _tail(self, one: _Submitted) -> str:
        """The last line of the job's log that says something."""
        paths = self._paths(one.number)
        for log in (paths.stderr, paths.stdout):
            with suppress(OSError):
                lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
                if lines:
                    return f"{lines[-1]} ({log})"
        return f"no word of it ({paths.stderr})"

    def _paths(self, number: str) -> Any:
        from submitit.core.utils import JobPaths

        return JobPaths(self._folder / "jobs", job_id=number)

    def _record(self, job: Job) -> Path:
        return self._records / f"{sha256(job.name.encode()).hexdigest()[:20]}.json"

    def _progress(self, job: Job) -> Path:
        return self._record(job).with_suffix(".progress")


@dataclass
class _OnNode:
    """The job's work on a node of the cluster. Its answer is (a field of `Outcome`, or "busy", and its text)."""

    work: Callable[[Report], str]
    progress: Path
    _last: float = field(default=0.0, repr=False)

    def __call__(self) -> tuple[str, str]:
        try:
            return "message", self.work(self._report)
        except Busy:
            return "busy", ""
        except Exception as error:
            if line := one_line(error):
                return "problem", line
            raise  # a bug: submitit keeps the traceback
        finally:
            self.progress.unlink(missing_ok=True)

    def checkpoint(self) -> Any:
        """What submitit queues again before a time limit: the same, as the training has been kept."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)

    def _report(self, report: Any) -> None:
        now = time.monotonic()
        if report == FREED or now - self._last < _REPORTED_EVERY:
            return
        self._last = now
        with suppress(OSError):  # as on a full disk: it is only shown
            write_json(self.progress, list(report))
