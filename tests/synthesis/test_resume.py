"""The same bytes however often it is started, stopped, and wherever it is."""

from __future__ import annotations

import signal
import sys

import pytest
from called import killed

from dofbench.core.errors import InputError
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import builder as make
from dofbench.datasets.synthesis import check_dataset, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset

SLOW = """
import sys, time
from pathlib import Path
from dofbench.datasets.synthesis import builder as make, make_dataset
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis.dataset_options import MakeDataset
blur = make.shallow_image
def slow(*arguments):
    time.sleep(0.3)
    return blur(*arguments)
make.shallow_image = slow
make_dataset(MakeDataset(scene=sys.argv[1], out=Path(sys.argv[2])), progress=Silent())
"""


class Stop(Exception):
    """Raised in the middle of a run."""


class Messages(Silent):
    """Keeps what the run says at its end."""

    def __init__(self):
        self.said = []

    def finished(self, folder, message):
        self.said.append(message)


def run(scene, out, progress=None, **options):
    return make_dataset(MakeDataset(scene=str(scene), out=out, **options), progress=progress or Silent())


def test_two_folders_two_times_the_same_bytes(scene, dataset_folder, tmp_path, contents):
    assert contents(run(scene, tmp_path / "elsewhere" / "other name")) == contents(dataset_folder)


def test_another_seed_is_another_dataset(scene, dataset_folder, tmp_path, contents):
    other = contents(run(scene, tmp_path / "out", seed=1))
    assert other["lens.json"] != contents(dataset_folder)["lens.json"]


@pytest.mark.slow
def test_killed_and_started_again(scene, dataset_folder, tmp_path, contents):
    out = tmp_path / "out"
    command = [sys.executable, "-c", SLOW, str(scene), str(out)]
    done = killed(command, lambda: len(list(out.glob("images/v*.png"))) >= 2)
    assert done.returncode == -signal.SIGKILL, done.stdout
    assert not (out / "dataset.json").exists()
    # What a kill in the middle of a write leaves.
    (out / "images" / ".dofbench-v03.abc.png").write_bytes(b"half")
    (out / "sparse" / "0" / ".dofbench-model.abc").mkdir(parents=True)
    (out / "sparse" / "0" / ".dofbench-model.abc" / "points3D.bin").write_bytes(b"half")
    finished = {path: path.stat().st_mtime_ns for path in out.glob("images/v*.png")}
    run(scene, out)
    assert contents(out) == contents(dataset_folder)
    assert all(path.stat().st_mtime_ns == before for path, before in finished.items())


@pytest.mark.parametrize(
    "function, calls",
    [
        ("encoded", 3),
        ("write_exr", 4),
        ("shallow_image", 1),
        ("write.geometry", 0),
        ("write.manifest", 0),
        ("finish", 0),
    ],
)
def test_stopped_at_any_stage(scene, dataset_folder, tmp_path, contents, monkeypatch, function, calls):
    owner, name = (make.write, function[6:]) if function.startswith("write.") else (make, function)
    real, count = getattr(owner, name), 0

    def stopping(*arguments, **options):
        nonlocal count
        count += 1
        if count > calls:
            raise Stop
        return real(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, stopping)
        with pytest.raises(Stop):
            run(scene, tmp_path / "out")
    run(scene, tmp_path / "out")
    assert contents(tmp_path / "out") == contents(dataset_folder)


def test_a_complete_dataset_is_left_alone(scene, tmp_path, monkeypatch):
    out = run(scene, tmp_path / "out")
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    monkeypatch.setattr(make, "_shallow", None)
    messages = Messages()
    run(scene, out, messages)
    assert messages.said == ["up to date"]
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before


def test_lost_and_damaged_files_are_made_again(scene, dataset_folder, tmp_path, contents, monkeypatch):
    out = run(scene, tmp_path / "out")
    (out / "images" / "v02.png").unlink()
    damaged = bytearray((out / "all_in_focus" / "v04.png").read_bytes())
    damaged[-30] ^= 1
    (out / "all_in_focus" / "v04.png").write_bytes(damaged)
    run(scene, out)
    assert contents(out) == contents(dataset_folder)
    assert check_dataset(out) == []


@pytest.mark.parametrize("options", [{"seed": 1}, {"width": 64}, {"gamma": 2.0}, {"hold": 3}])
def test_another_dataset_is_not_overwritten(scene, dataset_folder, contents, options):
    before = contents(dataset_folder)
    with pytest.raises(InputError, match="another dataset"):
        run(scene, dataset_folder, **options)
    assert contents(dataset_folder) == before


def test_an_unfinished_other_dataset_is_not_overwritten(scene, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(make, "shallow_image", None)
        with pytest.raises(TypeError):
            run(scene, tmp_path / "out")
    with pytest.raises(InputError, match="another dataset"):
        run(scene, tmp_path / "out", seed=1)


def test_a_run_that_made_nothing_is_no_obstacle(scene, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(make, "_all_in_focus", None)
        with pytest.raises(TypeError):
            run(scene, tmp_path / "out")
    assert check_dataset(run(scene, tmp_path / "out", seed=1)) == []


def test_a_changed_scene_is_another_dataset(write_scene, tmp_path):
    root = write_scene(tmp_path / "scene")
    out = run(root, tmp_path / "out")
    (root / "depth" / "v01.exr").write_bytes((root / "depth" / "v02.exr").read_bytes())
    with pytest.raises(InputError, match="another dataset"):
        run(root, out)


@pytest.mark.parametrize("seed", [0, 1])
def test_hidden_files_of_the_user_stay(scene, dataset_folder, tmp_path, monkeypatch, contents, seed):
    """Whether the same dataset is resumed, or the call is refused as another one."""
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(make, "shallow_image", None)
        with pytest.raises(TypeError):
            run(scene, out)
    own = [".git/config", ".dvc/cache/a", ".notes", "images/.thumbs", ".v03.abc.png", ".work/mine.txt"]
    for name in own:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_text("precious")
    (out / "images" / ".dofbench-v03.abc.png").write_bytes(b"half")
    before = contents(out)
    if seed:
        with pytest.raises(InputError, match="another dataset"):
            run(scene, out, seed=seed)
        assert contents(out) == before
    else:
        run(scene, out)
        assert contents(out) == {**contents(dataset_folder), **dict.fromkeys(own, b"precious")}


@pytest.mark.parametrize("content", [None, "[]", '{"identity": "of a reconstruction"}'])
def test_a_work_folder_of_another_program_is_left_alone(scene, tmp_path, content):
    work = tmp_path / "out" / ".work"
    work.mkdir(parents=True)
    (work / "thesis.tex").write_text("precious")
    if content is not None:
        (work / "state.json").write_text(content)
    with pytest.raises(InputError, match="a folder that make-dataset didn't make"):
        run(scene, tmp_path / "out")
    assert (work / "thesis.tex").read_text() == "precious"


def test_one_writer_at_a_time(scene, tmp_path, monkeypatch):
    class Nested(Silent):
        def stage(self, name, total):
            with pytest.raises(InputError, match="another run"):
                run(scene, tmp_path / "out")
            return super().stage(name, total)

    run(scene, tmp_path / "out", Nested())
