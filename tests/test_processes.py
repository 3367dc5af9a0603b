"""Jobs in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from filelock import FileLock

from dofbench.core.errors import InputError
from dofbench.core.jobs import FREED, Busy, Job, Resources
from dofbench.runtime.memory import machine_memory_mb
from dofbench.runtime.processes import LocalProcesses


class Log:
    """Records its calls."""

    def __init__(self):
        self.events = []

    def started(self, name):
        self.events.append(("started", name))

    def reported(self, name, report):
        self.events.append(("reported", name, report))

    def put_off(self, name):
        self.events.append(("put off", name))

    def idle(self, waiting):
        self.events.append(("idle", waiting))

    def ended(self, outcome):
        self.events.append(("ended", outcome.name))


def work(how, report):
    report({"pid": os.getpid(), "threads": os.environ["OMP_NUM_THREADS"]})
    if how == "wrong input":
        raise InputError("a.json", "no\nnumber", "one")
    if how == "refused":
        raise PermissionError(13, "Permission denied", "out")
    if how == "bug":
        raise ValueError("shapes")
    if how == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    return f"{how}, done"


def safe_path(report):
    return f"{sys.flags.safe_path} {os.environ.get('PYTHONSAFEPATH')}"


def jobs(*kinds, **after):
    # A test file isn't importable in the processes: the function goes by its source, as a module.
    return [Job(kind, partial(_spawned().work, kind), after.get(kind)) for kind in kinds]


def _spawned():
    import importlib

    folder = str(Path(__file__).parent)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return importlib.import_module("test_processes")


def test_every_end_is_told_apart_and_none_stops_the_others(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "6")
    log = Log()
    outcomes = LocalProcesses(2).run(jobs("wrong input", "refused", "bug", "killed", "well"), log)
    assert [(outcome.name, outcome.message) for outcome in outcomes] == [
        ("wrong input", ""),
        ("refused", ""),
        ("bug", ""),
        ("killed", ""),
        ("well", "well, done"),
    ]
    wrong, refused, bug, killed, well = (outcome.problem for outcome in outcomes)
    assert wrong == "a.json: found no number, expected one"
    assert refused == "out: Permission denied; finished work is kept"
    assert bug.startswith("Traceback") and "ValueError: shapes" in bug
    assert killed == "its process was killed by signal 9 (SIGKILL)"
    assert well == ""
    reports = [event[2] for event in log.events if event[0] == "reported"]
    assert len({report["pid"] for report in reports} - {os.getpid()}) == 5
    assert {report["threads"] for report in reports} == {"3"}
    assert os.environ["OMP_NUM_THREADS"] == "6"
    running = most = 0
    for event in log.events:
        running += (event[0] == "started") - (event[0] == "ended")
        most = max(most, running)
    assert most == 2


@pytest.mark.parametrize(("before", "within"), [(None, "True None"), ("1", "True 1")])
def test_a_process_is_started_safely_and_starts_others_as_the_user_would(monkeypatch, before, within):
    """The command of an external method may need modules beside its script."""
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    if before:
        monkeypatch.setenv("PYTHONSAFEPATH", before)
    (outcome,) = LocalProcesses(1).run([Job("one", _spawned().safe_path)], Log())
    assert outcome.message == within
    assert os.environ.get("PYTHONSAFEPATH") == before


@pytest.mark.parametrize("first", ["well", "killed"])
def test_a_job_waits_for_the_one_before(first):
    log = Log()
    outcomes = LocalProcesses(2).run([*jobs("second", second=first), *jobs(first)], log)
    assert [outcome.name for outcome in outcomes] == ["second", first]
    assert log.events.index(("ended", first)) < log.events.index(("started", "second"))


def busy_for(calls):
    left = [True] * calls
    return lambda: bool(left and left.pop())


def test_a_busy_job_is_left_for_later_and_done_at_the_end():
    log = Log()
    first, second = jobs("well", "wrong input")
    outcomes = LocalProcesses(1).run([Job(first.name, first.work, busy=busy_for(2)), second], log)
    assert [event[1] for event in log.events if event[0] == "started"] == ["wrong input", "well"]
    assert [outcome.name for outcome in outcomes] == ["well", "wrong input"] and outcomes[0].message == "well, done"


def test_what_another_process_has_done_starts_none():
    log = Log()
    met, other = jobs("well", "wrong input")
    finished = iter(["", "well, by another process"])
    job = Job(met.name, _spawned().meets, busy=busy_for(1), done=partial(next, finished))
    outcomes = LocalProcesses(1).run([job, other], log)
    assert outcomes[0].message == "well, by another process"
    assert [event[:2] for event in log.events if event[0] not in ("reported", "idle")] == [
        ("started", "wrong input"),
        ("ended", "wrong input"),
        ("started", "well"),  # and meets another process that has just begun it
        ("put off", "well"),
        ("ended", "well"),
    ]


def test_while_all_is_another_process_s_it_waits_and_says_so():
    log = Log()
    (job,) = jobs("well")
    (outcome,) = LocalProcesses(1).run([Job(job.name, job.work, busy=busy_for(1))], log)
    assert outcome.message == "well, done" and log.events[0] == ("idle", 1)


def meets(report):
    raise Busy("another")


PARENT = """
import signal, sys
sys.path.insert(0, {folder!r})
import test_processes as tests
# What a shell starts in the background ignores Ctrl-C, and so do its children: not what is asked here.
signal.signal(signal.SIGINT, signal.default_int_handler)
if __name__ == "__main__":
    class Loud(tests.Log):
        def reported(self, name, report):
            print(report, flush=True)
    tests.LocalProcesses(1).run([tests.Job("forever", tests.forever)], Loud())
"""


def forever(report):
    report(os.getpid())
    time.sleep(600)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_no_process_outlives_its_parent(tmp_path, number):
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(folder=str(Path(__file__).parent)))
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as parent:
        child = int(parent.stdout.readline())
        os.kill(parent.pid, number)
        parent.wait(60)
    limit = time.monotonic() + 60
    while Path(f"/proc/{child}").exists() and Path(f"/proc/{child}/stat").read_text().split()[2] != "Z":
        assert time.monotonic() < limit
        time.sleep(0.05)


def waits(folder, name, report):
    """Reports that it has begun, and ends once every job named in the folder has begun too, or after a while."""
    (Path(folder) / name).touch()
    limit = time.monotonic() + 2
    while len(list(Path(folder).iterdir())) < 2 and time.monotonic() < limit:
        time.sleep(0.01)
    return f"{len(list(Path(folder).iterdir()))} begun"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("takes", "together"),
    [
        ([Resources(), Resources()], True),
        ([Resources("cuda"), Resources("cuda")], False),
        ([Resources("cuda:0"), Resources("cuda:1")], True),
        ([Resources("cuda"), Resources("cpu")], True),
        ([Resources(memory_mb=600.0), Resources(memory_mb=500.0)], False),
        ([Resources(memory_mb=600.0), Resources(memory_mb=400.0)], True),
        ([Resources(memory_mb=2000.0), Resources()], True),  # nobody knows of the second; the first runs in any case
    ],
    ids=str,
)
def test_jobs_run_side_by_side_where_the_machine_has_room(tmp_path, takes, together):
    work = _spawned().waits
    jobs = [Job(f"{i}", partial(work, str(tmp_path), f"{i}"), takes=one) for i, one in enumerate(takes)]
    first, second = LocalProcesses(2, memory_mb=1000.0).run(jobs, Log())
    assert not first.problem and not second.problem
    assert first.message == ("2 begun" if together else "1 begun") and second.message == "2 begun"


def sees(folder, name, report):
    """As `waits`, and says which GPUs it sees."""
    return waits(folder, name, report), os.environ.get("CUDA_VISIBLE_DEVICES")


def frees(folder, name, report):
    """As `waits`, after it has freed its accelerator."""
    report(FREED)
    return waits(folder, name, report)


@pytest.mark.parametrize(
    ("visible", "takes", "expected"),
    [
        (None, ["cuda", "cuda"], ["0", "1"]),
        ("3, 5", ["cuda", "cuda"], ["3", "5"]),
        ("3,5", ["cuda:0", "cuda"], ["3,5", "5"]),  # who names a GPU sees all of them
        (None, ["cpu", "cuda"], [None, "0"]),
    ],
)
def test_each_job_that_asks_for_any_gpu_sees_one_of_its_own(tmp_path, monkeypatch, visible, takes, expected):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    if visible is not None:
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    work = _spawned().sees
    jobs = [Job(f"{i}", partial(work, str(tmp_path), f"{i}"), takes=Resources(one)) for i, one in enumerate(takes)]
    outcomes = LocalProcesses(2, gpus=2).run(jobs, Log())
    assert [outcome.message for outcome in outcomes] == [("2 begun", one) for one in expected]
    assert os.environ.get("CUDA_VISIBLE_DEVICES") == visible


def test_two_commands_share_the_gpus(tmp_path, monkeypatch):
    """The one that the other has is left to it, and taken when it is free."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "all"))
    (tmp_path / "all").mkdir()
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    other = FileLock(tmp_path / "all" / "dofbench-gpu-0.lock", thread_local=False)
    other.acquire()
    job = Job("0", partial(_spawned().sees, str(tmp_path / "all"), "0"), takes=Resources("cuda"))
    (outcome,) = LocalProcesses(2, gpus=2).run([job], Log())
    assert outcome.message[1] == "1"
    threading.Timer(1.5, other.release).start()
    log, begun = Log(), time.monotonic()
    (outcome,) = LocalProcesses(2, gpus=1).run([job], log)
    assert not outcome.problem and log.events[0] == ("idle", 1) and time.monotonic() - begun > 1


def test_a_third_job_waits_for_one_of_two_gpus(tmp_path):
    work = _spawned().sees
    jobs = [Job(f"{i}", partial(work, str(tmp_path), f"{i}"), takes=Resources("cuda")) for i in range(3)]
    outcomes = LocalProcesses(3, gpus=2).run(jobs, Log())
    assert [outcome.message[0] for outcome in outcomes] == ["2 begun", "2 begun", "3 begun"]


def test_a_job_that_needs_its_accelerator_no_longer_lets_the_next_one_begin(tmp_path):
    work, log = _spawned(), Log()
    jobs = [Job(f"{i}", partial(work.frees, str(tmp_path), f"{i}"), takes=Resources("cuda")) for i in range(2)]
    first, second = LocalProcesses(2).run(jobs, log)
    assert first.message == second.message == "2 begun"


def test_memory_is_the_container_s_where_it_has_less(tmp_path):
    whole = machine_memory_mb(tmp_path)
    assert 100 < whole < 1e8
    (tmp_path / "memory.max").write_text("max\n")
    assert machine_memory_mb(tmp_path) == whole
    (tmp_path / "memory.max").write_text("50000000\n")
    assert machine_memory_mb(tmp_path) == 50.0
