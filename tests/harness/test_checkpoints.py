"""Trainings that are cut off: what they leave, and that the same command goes on with it to the same end."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from called import called, dofbench, killed, timeless

from dofbench.core.content import content_folder
from dofbench.core.errors import Interrupted
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.evaluation.results.result import read_result
from dofbench.running import checkpoints as checkpoints_module
from dofbench.running.checkpoints import CHECKPOINT_FOLDER, Checkpoints


class Counting:
    """A method whose training is a number."""

    def __init__(self) -> None:
        self.number = self.asked = 0

    def training_state(self) -> int:
        return self.number

    def constant_state(self) -> str:
        self.asked += 1
        return "prior"

    def resume_from(self, state: int, constant: str) -> None:
        assert constant == "prior"
        self.number = state


def checkpoints(folder: Path, key: str = "a") -> tuple[Checkpoints, Counting]:
    method = Counting()
    return Checkpoints(folder, key, method, "2026-01-01"), method


def saved(folder: Path, *steps: int) -> list[Path]:
    kept, method = checkpoints(folder)
    for step in steps:
        method.number = 10 * step
        kept.save(step, {"steps": step})
    assert method.asked == 1
    return sorted((folder / CHECKPOINT_FOLDER).glob("0*.pt"))


def test_the_last_two_are_kept_and_the_last_counts(tmp_path: Path) -> None:
    assert len(saved(tmp_path, 3, 5, 11)) == 2
    kept, method = checkpoints(tmp_path)
    assert kept.resume() == {"steps": 11} and method.number == 110 and kept.resumed == [11]
    kept.remove()
    assert checkpoints(tmp_path)[0].resume() is None


@pytest.mark.parametrize("damage", [lambda data: b"", lambda data: data[: len(data) // 2], lambda data: b"no" + data])
def test_for_a_damaged_one_the_one_before_is_taken(damage, tmp_path: Path) -> None:
    last = saved(tmp_path, 3, 5)[-1]
    last.write_bytes(damage(last.read_bytes()))
    kept, method = checkpoints(tmp_path)
    assert kept.resume() == {"steps": 3} and method.number == 30


def test_another_run_doesnt_resume_from_it(tmp_path: Path) -> None:
    saved(tmp_path, 3)
    assert checkpoints(tmp_path, key="b")[0].resume() is None


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR2])
def test_a_signal_waits_for_the_end_of_the_step(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, _ = checkpoints(tmp_path)
    before = signal.getsignal(number)
    with kept.listening():
        assert not kept.due()
        signal.raise_signal(number)
        assert kept.due()
        signal.raise_signal(number)  # to the group, and forwarded by the parent
        with pytest.raises(Interrupted):
            kept.save(2, {})
        monkeypatch.setattr(checkpoints_module, "TWICE", 0.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)  # whoever asks twice doesn't want to wait
    assert signal.getsignal(number) == before and checkpoints(tmp_path)[0].resume() == {}
    with kept.listening(), pytest.raises(KeyboardInterrupt):
        checkpoints_of_no_step, _ = checkpoints(tmp_path)
        with checkpoints_of_no_step.listening():
            signal.raise_signal(number)


def test_a_full_disk_ends_no_training(tmp_path: Path) -> None:
    (tmp_path / CHECKPOINT_FOLDER).write_text("in the way")
    kept, _ = checkpoints(tmp_path)
    kept.save(3, {})
    assert "step 3" in kept.problem


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "data"
    make_dataset(MakeDataset(scene=str(content_folder("datasets") / "thinlens" / "foliage"), width=48, out=folder))
    return folder


def command(data: Path, out: Path, *more: object) -> list[str]:
    return dofbench("run", "--method", "3dgs", "--budget", "1500it", "--data", data, "--out", out, "--watch", *more)


def test_what_sigterm_cuts_off_ends_as_if_it_had_not(data: Path, tmp_path: Path) -> None:
    def going() -> bool:
        return any((tmp_path / "cut").glob("*/*/snapshots/0*"))

    cut = command(data, tmp_path / "cut")
    done = killed(cut, going, number=signal.SIGTERM)
    assert done.returncode == 128 + signal.SIGTERM, done.stdout
    (file,) = (tmp_path / "cut").rglob("result.json")
    left = read_result(file)
    assert left.status == "interrupted" and "resume" in left.message
    assert list(file.parent.glob(f"{CHECKPOINT_FOLDER}/*.pt"))
    again = called(cut)
    assert again.returncode == 0 and "resuming from the checkpoint" in again.stdout, again.stdout + again.stderr
    whole = called(command(data, tmp_path / "whole"))
    assert whole.returncode == 0, whole.stderr
    (other,) = (tmp_path / "whole").rglob("result.json")
    assert timeless(read_result(file)) == timeless(read_result(other))
    assert len(read_result(file).resumed) == 1 and read_result(other).resumed == []
    assert not (file.parent / CHECKPOINT_FOLDER).exists()
    assert called(dofbench("check", tmp_path / "cut")).returncode == 0


@pytest.mark.slow
def test_so_it_is_in_a_worker(data: Path, tmp_path: Path) -> None:
    def going() -> bool:
        return len({path.parent for path in (tmp_path / "cut").glob("*/*/snapshots/0*")}) == 2

    cut = command(data, tmp_path / "cut", "--seeds", "2", "--jobs", "2")
    done = killed(cut, going, number=signal.SIGTERM)
    assert done.returncode == 128 + signal.SIGTERM, done.stdout
    assert [read_result(file).status for file in (tmp_path / "cut").rglob("result.json")] == ["interrupted"] * 2
    assert called(cut).returncode == 0
    assert all(read_result(file).resumed for file in (tmp_path / "cut").rglob("result.json"))
