"""Runs whose process a signal ends: a lack of memory leaves a typed result, and other ends stay what they were."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from called import PATIENCE, called, dofbench, fake_method_and_data

from dofbench.evaluation.results.collecting import dead_entry
from dofbench.evaluation.results.result import Result, read_result
from dofbench.runtime.memory_evidence import MemoryWatch

# A method that dies in native code once it trains.
DEATHS = """

import ctypes
import os
import signal
import time
from pathlib import Path


class Dying(Fake):
    def fit(self, training_set, budget, observer):
        how = os.environ["FAKE_DEATH"]
        if budget.steps == 1 or not how:  # the warm-up
            return super().fit(training_set, budget, observer)
        if how == "full":
            malloc = ctypes.CDLL(None).malloc
            malloc.restype, malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
            while malloc(1 << 26):
                pass
            time.sleep(1.0)  # the parent takes samples
            ctypes.memset(malloc(1 << 26), 0, 1)
        if how == "wait":
            Path(os.environ["FAKE_BEGUN"]).touch()
            time.sleep(600)
        os.kill(os.getpid(), getattr(signal, how))
"""
LIMITED = ("bash", "-c", 'ulimit -v 12000000; exec "$@"', "bash")


@pytest.fixture
def dying(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """`dofbench run` with a method that dies as FAKE_DEATH says."""
    fake_method_and_data(tmp_path, monkeypatch, 48, DEATHS, "Dying")
    monkeypatch.setenv("FAKE_BEGUN", str(tmp_path / "begun"))
    return dofbench("run", "--method", "fake", "--data", tmp_path / "data", "--out", tmp_path / "results")


def results(folder: Path) -> list[Result]:
    return [read_result(file) for file in (folder / "results").rglob("result.json")]


@pytest.mark.slow
def test_a_native_death_at_the_limit_is_out_of_memory(dying: list[str], tmp_path: Path) -> None:
    done = called([*LIMITED, *dying], FAKE_DEATH="full")
    (result,) = results(tmp_path)
    assert (done.returncode, result.status) == (1, "out_of_memory")
    assert "SIGSEGV" in result.message and "SIGSEGV" in done.stderr.splitlines()[-1]
    assert result.scores["peak_mb"] > 0 and "train_s" in result.left_out
    assert called(dofbench("check", tmp_path / "results")).returncode == 0
    again = called(dying, FAKE_DEATH="")
    assert (again.returncode, [one.status for one in results(tmp_path)]) == (0, ["ok"])


@pytest.mark.slow
def test_so_it_is_in_a_worker(dying: list[str], tmp_path: Path) -> None:
    done = called([*LIMITED, *dying, "--seeds", "2", "--jobs", "2"], FAKE_DEATH="full")
    assert done.returncode == 1
    assert [result.status for result in results(tmp_path)] == ["out_of_memory"] * 2
    assert len([line for line in done.stdout.splitlines() if line.startswith("failed: ")]) == 2
    assert done.stdout.count("failed: ") == done.stdout.count("out_of_memory: ended by SIGSEGV"), done.stdout


@pytest.mark.parametrize("name", [pytest.param("SIGABRT", marks=pytest.mark.slow), "SIGKILL"])
def test_a_death_without_evidence_is_a_crash(name: str, dying: list[str], tmp_path: Path) -> None:
    done = called(dying, FAKE_DEATH=name)
    assert done.returncode == -signal.Signals[name] and results(tmp_path) == []
    (lease,) = (tmp_path / "results").rglob("running.lock")
    entry = dead_entry(lease.parent)
    assert entry is not None and entry.status == "crashed"


@pytest.mark.parametrize(
    ("number", "to_group"),
    [
        pytest.param(signal.SIGINT, False, marks=pytest.mark.slow),
        (signal.SIGINT, True),
        pytest.param(signal.SIGTERM, True, marks=pytest.mark.slow),
    ],
)
def test_an_interruption_reaches_the_run_once(
    number: signal.Signals, to_group: bool, dying: list[str], tmp_path: Path
) -> None:
    environment = {**os.environ, "FAKE_DEATH": "wait"}
    process = subprocess.Popen(dying, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment)
    limit = time.monotonic() + PATIENCE
    while not (tmp_path / "begun").exists():
        assert process.poll() is None and time.monotonic() < limit
        time.sleep(0.01)
    (os.killpg if to_group else os.kill)(process.pid, number)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + number and "Traceback" not in said
    assert [(one.status, one.message) for one in results(tmp_path)] == [
        ("interrupted", "after 0 steps; rerun the same command to resume")
    ]


@pytest.mark.slow
def test_the_run_ends_with_its_parent(dying: list[str], tmp_path: Path) -> None:
    process = subprocess.Popen(dying, env={**os.environ, "FAKE_DEATH": "wait"})
    while not (tmp_path / "begun").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    again = called(dying, FAKE_DEATH="")
    assert again.returncode == 0, again.stderr


@pytest.mark.parametrize("counter", ["sys/fs/cgroup/a/memory.events", "sys/fs/cgroup/memory/b/memory.oom_control"])
def test_the_oom_killer_is_seen_by_its_counter(counter: str, tmp_path: Path) -> None:
    for name, text in {"proc/self/cgroup": "4:memory:/b\n0::/a\n", counter: "oom 3\noom_kill 7\n"}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    watch = MemoryWatch(os.getpid(), tmp_path)
    assert watch.evidence(signal.SIGKILL) == ""
    (tmp_path / counter).write_text("oom 4\noom_kill 8\n")
    assert "OOM killer" in watch.evidence(signal.SIGKILL)
    assert watch.evidence(signal.SIGSEGV) == ""


def test_a_watch_sees_a_peak() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        time.sleep(0.2)
        assert MemoryWatch(process.pid).peak_mb > 0
        process.communicate(b"\n")
