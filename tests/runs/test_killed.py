"""The command as a user calls it: killed at several moments, and two at once, on one folder of results."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

import pytest
from called import PATIENCE, called, dofbench, fake_method_and_data

from dofbench.evaluation.results.result import read_result

# What the fake does is written down; where a file says so, its command is killed there, and its process with it.
MOMENTS = """

import os
import signal
from pathlib import Path

LOG = Path(os.environ["FAKE_LOG"])
COMMAND = os.getppid()


def moment(name, seed):
    with open(LOG / "log.txt", "a") as stream:
        stream.write(f"{name} {seed}\\n")
    file = LOG / f"kill-{name}-{seed}"
    if file.exists():
        try:
            os.close(os.open(LOG / f"killed-{COMMAND}", os.O_CREAT | os.O_EXCL))
        except FileExistsError:  # another run's moment has killed this call: this one is for the next
            os.kill(os.getpid(), signal.SIGKILL)
        file.unlink()
        os.kill(os.getppid(), signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)


class Watched(Fake):
    def fit(self, training_set, budget, observer):
        if budget.steps == 1:
            return super().fit(training_set, budget, observer)
        moment("begun", self.seed)
        outcome = super().fit(training_set, budget, observer)
        moment("trained", self.seed)
        return outcome

    def load(self, folder):
        super().load(folder)
        moment("saved", self.seed)

    def describe(self):
        moment("scored", self.seed)
        return super().describe()
"""


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """`dofbench run` with three seeds on a small dataset, with a method that costs nothing, two runs at a time."""
    fake_method_and_data(tmp_path, monkeypatch, 48, MOMENTS, "Watched")
    (tmp_path / "log").mkdir()
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    data, results = tmp_path / "data", tmp_path / "results"
    return dofbench("run", "--method", "fake", "--data", data, "--seeds", 3, "--jobs", 2, "--out", results)


def counts(folder: Path) -> Counter[str]:
    return Counter((folder / "log" / "log.txt").read_text().splitlines())


def finished(folder: Path) -> dict[Path, tuple[int, bytes]]:
    return {file: (file.stat().st_mtime_ns, file.read_bytes()) for file in (folder / "results").rglob("result.json")}


@pytest.mark.slow
def test_killed_at_every_moment_it_goes_on(command: list[str], tmp_path: Path) -> None:
    moments = ("begun 0", "trained 0", "saved 1", "scored 2")
    for moment in moments:
        (tmp_path / "log" / f"kill-{moment.replace(' ', '-')}").touch()
    kept: dict[Path, tuple[int, bytes]] = {}
    calls = 0
    while True:
        calls += 1
        done = called(command)
        now = finished(tmp_path)
        assert kept.items() <= now.items()  # what was finished stays as it was
        kept = now
        if done.returncode != -9:
            break
    assert done.returncode == 0, done.stdout + done.stderr
    assert calls == 1 + len(moments) and not list((tmp_path / "log").glob("kill-*"))
    assert sorted(read_result(file).spec.seed for file in kept) == [0, 1, 2]
    for file in kept:
        assert read_result(file).status == "ok"
        assert sorted(path.name for path in file.parent.iterdir()) == ["model", "predictions", "result.json"]
    # A training that was over and kept isn't repeated: seed 1 died after its model was saved but not yet noted down.
    assert counts(tmp_path)["trained 2"] == 1
    again = called(command)
    assert again.returncode == 0 and "3 of them cached" in again.stdout and finished(tmp_path) == kept


@pytest.mark.slow
def test_two_commands_at_once_share_the_work(command: list[str], tmp_path: Path) -> None:
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) for _ in range(2)]
    said = [process.communicate(timeout=PATIENCE)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert {name: count for name, count in counts(tmp_path).items() if name.startswith("trained")} == {
        "trained 0": 1,
        "trained 1": 1,
        "trained 2": 1,
    }
    assert len(finished(tmp_path)) == 3
    assert all("3 of 3 runs ok" in one for one in said)


@pytest.mark.slow
def test_a_run_whose_process_is_killed_is_named(command: list[str], tmp_path: Path) -> None:
    methods = tmp_path / "methods" / "fake" / "trainer.py"
    methods.write_text(methods.read_text().replace("os.kill(os.getppid(), signal.SIGKILL)", "pass"))
    (tmp_path / "log" / "kill-begun-1").touch()
    done = called(command)
    assert done.returncode == 1
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("failed: ")]
    assert "fake-quick-seed1-" in line and line.endswith("its process was killed by signal 9 (SIGKILL)")
    assert len(finished(tmp_path)) == 2
    assert called(command).returncode == 0
    assert counts(tmp_path)["trained 0"] == counts(tmp_path)["trained 1"] == 1
