"""Another program as a method: what it is given, what is read of what it leaves, and how its failures end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from rich.console import Console
from small_dataset import write_dataset

import dofbench
from dofbench.core.budget import Budget
from dofbench.core.errors import InputError, Status
from dofbench.evaluation.results.provenance import code_version

CARD = """
name = "Program"
summary = "another program"
paper = "none"
class = "method:Program"
default_preset = "plain"
elsewhere = true

[capabilities]
refocus = true
learns_lens = true
needs_points = false

[presets.plain]
budget = "7it"
train = "{python} {{here}}/program.py train {{scene}} {{model}} {steps} '{told}'"
render = "{python} {{here}}/program.py render {{model}} {{views}} {{pictures}} '{told}'"
"""

# Shows grey pictures, all in focus or by the aperture that it is asked for, and says the lenses that it was told.
PROGRAM = """
import json, os, shutil, subprocess, sys, time
from pathlib import Path
import cv2
import numpy as np

told = json.loads(sys.argv[-1])
if sys.argv[1] == "train":
    scene, model, steps = Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4]
    shutil.copytree(scene, told["copy"], dirs_exist_ok=True)
    (model / "figures.json").write_text(json.dumps({"steps": int(steps or 0) + 1, "gaussians": 5}))
    (model / "lenses.json").write_text(json.dumps(told["lenses"]))
    TRAIN
else:
    model, views, pictures = map(Path, sys.argv[2:5])
    wanted = json.loads((views / "transforms.json").read_text())
    Path(told["copy"], "wanted.json").write_text(json.dumps(wanted))
    for frame in wanted["frames"]:
        size = {**wanted, **frame}
        grey = 100 if "lens" not in frame else round(100 + 200 * frame["lens"]["focus_disparity"])
        file = pictures / frame["file_path"]
        cv2.imwrite(str(file), np.full((size["h"], size["w"], 3), grey, np.uint8))
        np.save(file.with_suffix(".npy"), np.full((size["h"], size["w"]), 3.0))
    RENDER
"""

Make = Callable[..., dofbench.Outcome]


def lens(dataset: dofbench.Dataset, name: str) -> dict[str, float]:
    (view,) = [view for view in dataset.training_views() if view.name == name]
    return dict(vars(view.physical_lens))


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """A function that runs the program on the small dataset, with a line more of training or rendering. lenses: what
    it says of them, all true ones unless given."""
    dataset = dofbench.Dataset.load(write_dataset(tmp_path / "data"))
    truth = {view.name: lens(dataset, view.name) for view in dataset.training_views()}
    folder = tmp_path / "methods" / "program"
    folder.mkdir(parents=True)
    monkeypatch.setenv("DOFBENCH_METHODS", str(folder.parent))

    def make(train: str = "pass", render: str = "pass", lenses: object = truth, **changes) -> dofbench.Outcome:
        told = json.dumps({"copy": str(tmp_path / "copy"), "lenses": lenses}).replace('"', '\\"')
        (folder / "method.toml").write_text(CARD.format(python=sys.executable, steps="{steps}", told=told))
        text = textwrap.dedent(PROGRAM).replace("TRAIN", train).replace("RENDER", render)
        (folder / "program.py").write_text(text)
        (folder / "method.py").write_text("from dofbench import External\n\nclass Program(External): pass\n")
        settings = {"method": "program", "data": tmp_path / "data", "out": tmp_path / "results", **changes}
        return dofbench.run(dofbench.RunSpec(**settings), Console(quiet=True))

    return make


def result_of(end: dofbench.Outcome) -> dofbench.Result:
    return dofbench.read_result(end.folder)


@pytest.mark.slow
def test_pictures_and_lenses_are_scored(made: Make, tmp_path: Path) -> None:
    burn = "start = time.process_time(); _ = [i for i in iter(lambda: time.process_time() - start < 0.5, False)]"
    end = made(train=f"{burn}; room = bytearray(300_000_000)")
    found = result_of(end)
    assert found.status is Status.OK, found.message
    dataset = dofbench.Dataset.load(tmp_path / "data")
    views = dataset.test_views()
    errors = [dataset.image(view) - round(100 + 200 * view.physical_lens.focus_disparity) / 255 for view in views]
    expected = np.mean([-10 * np.log10(np.mean(error.astype(np.float64) ** 2)) for error in errors])
    assert found.scores["psnr"] == pytest.approx(expected)
    assert found.scores["delta_a"] == pytest.approx(0) and found.scores["delta_f"] == pytest.approx(0)
    assert found.scores["steps"] == 8 and found.scores["gaussians"] == 5
    assert found.scores["train_cpu_s"] >= 0.5 and found.scores["peak_mb"] >= 300
    assert found.left_out["render_fps"] == "the method renders in another program"
    assert [point.steps for point in found.curve] == [8]
    assert "disparity_error" in found.scores and "resolved" in found.scores
    assert {"pictures/sharp/0000.png", "lenses.json", "log.txt"} <= {
        name.removeprefix("model/") for name in found.model
    }
    # What was kept shows the same pictures, and no others.
    kept = dofbench.load_run(end.folder).method
    assert kept.render(views[0].camera, None).image.max() == pytest.approx(100 / 255)
    with pytest.raises(ValueError, match="test views"):
        kept.render(views[0].camera.resized(8, 6), None)
    assert made(train=f"{burn}; room = bytearray(300_000_000)").reused


def test_what_the_program_is_given(made: Make, tmp_path: Path) -> None:
    made()
    dataset = dofbench.Dataset.load(tmp_path / "data")
    views, copy = dataset.training_views(), tmp_path / "copy"
    names = [view.name for view in views]
    assert sorted(file.name for file in (copy / "images").iterdir()) == [f"{name}.png" for name in names]
    for view in views:
        given = dofbench.read_image(copy / "images" / f"{view.name}.png")
        assert np.array_equal(given, dofbench.read_image(tmp_path / "data" / "images" / f"{view.name}.png"))
    model = pycolmap.Reconstruction(copy / "sparse" / "0")
    assert sorted(image.name for image in model.images.values()) == [f"{name}.png" for name in names]
    assert model.num_points3D() and np.load(copy / "poses_bounds.npy").shape == (len(names), 17)
    frames = json.loads((copy / "transforms.json").read_text())["frames"]
    assert [frame["file_path"] for frame in frames] == [f"images/{name}.png" for name in names]
    wanted = json.loads((copy / "wanted.json").read_text())["frames"]
    tests = dataset.test_views()
    with_lens = [frame["lens"] for frame in wanted if "lens" in frame]
    assert with_lens == [vars(view.physical_lens) for view in tests]
    sharp = [frame for frame in wanted if "lens" not in frame]
    centres = [[row[3] for row in frame["transform_matrix"][:3]] for frame in sharp]
    assert np.allclose(centres, [view.camera.centre for view in [*tests, *views]])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "status", "message"),
    [
        ({"train": "print('a\\nb\\nc\\nno', 'CUDA'); sys.exit(3)"}, Status.CRASHED, "exit status 3: b | c | no CUDA"),
        ({"train": "os.kill(os.getpid(), 9)"}, Status.CRASHED, "killed by signal 9"),
        ({"train": "sys.exit('CUDA error: out of memory')"}, Status.OUT_OF_MEMORY, "out of memory"),
        ({"train": "time.sleep(60)", "set": ("limit=1",)}, Status.OUT_OF_TIME, "after 1 s, its limit"),
        (
            {"train": "time.sleep(60)", "set": ("grace=0.5",), "budget": Budget(seconds=1.0)},
            Status.OUT_OF_TIME,
            "ended after",
        ),
        (
            {"train": "room = bytearray(400_000_000); time.sleep(60)", "set": ("memory_gb=0.3",)},
            Status.OUT_OF_MEMORY,
            "its limit is 300 MB",
        ),
        ({"render": "time.sleep(60)", "set": ("render_limit=1",)}, Status.OUT_OF_TIME, "after 1 s"),
        ({"render": "(pictures / 'sharp/0001.png').unlink()"}, Status.CRASHED, "0001.png"),
        ({"render": "(pictures / 'sharp/0001.png').write_text('no')"}, Status.CRASHED, "0001.png"),
        (
            {"render": "cv2.imwrite(str(pictures / 'sharp/0001.png'), np.zeros((9, 9, 3)))"},
            Status.CRASHED,
            "0001.png: found 9 x 9 pixels, expected",
        ),
        ({"render": "np.save(pictures / 'sharp/0001.npy', np.zeros(3))"}, Status.CRASHED, "of shape (3,), expected"),
        ({"render": "(pictures / 'sharp/0000.npy').unlink()"}, Status.DIVERGED, "of the depth"),
        ({"lenses": {"v2": {"aperture": 1.0}}}, Status.CRASHED, "lenses.json: found v2.focus_disparity"),
        ({"lenses": {}}, Status.CRASHED, "no lens of v2 (4 are missing)"),
        ({"train": "(model / 'figures.json').write_text('[1]')"}, Status.CRASHED, "figures.json"),
        ({"train": "(model / 'figures.json').write_text('{\"steps\": NaN}')"}, Status.CRASHED, "steps = nan"),
    ],
)
def test_a_failure_has_a_typed_status(made: Make, changes: dict[str, object], status: Status, message: str) -> None:
    end = made(**changes)
    found = result_of(end)
    assert end.status is status and message in found.message, found.message
    assert ("a\nb\nc\nno CUDA" in found.traceback) == ("b | c" in message)


def alive(pid: int) -> bool:
    """Whether the process runs; one that has ended and that nobody waits for doesn't."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 30
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_nothing_is_left_of_a_program_that_is_ended(made: Make, tmp_path: Path) -> None:
    note = tmp_path / "pid"
    begin = f"child = subprocess.Popen(['sleep', '60']); Path({str(note)!r}).write_text(str(child.pid)); time.sleep(60)"
    assert made(train=begin, set=("limit=1",)).status is Status.OUT_OF_TIME
    wait_until(lambda: not alive(int(note.read_text())))


def test_a_program_ends_with_the_process_that_started_it(tmp_path: Path) -> None:
    note = tmp_path / "pid"
    program = f"import os, time; open({str(note)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    script = f"""
        import sys
        from pathlib import Path
        from dofbench.methods.external.limited_command import Limits, run_command
        command = [sys.executable, "-c", {program!r}]
        run_command(command, Path.cwd(), Path({str(tmp_path / "log")!r}), Limits(60, 1e6), lambda seconds: None)
    """
    parent = subprocess.Popen([sys.executable, "-c", textwrap.dedent(script)])
    wait_until(lambda: note.is_file() and bool(note.read_text()))
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    wait_until(lambda: not alive(int(note.read_text())))


def test_a_wrong_command_is_the_users_mistake(made: Make) -> None:
    with pytest.raises(InputError, match="option train: found no command"):
        made(set=("train=",))
    with pytest.raises(InputError, match="nowhere: found no program"):
        made(set=("train=nowhere {scene}",))


def test_the_programs_own_text_is_part_of_the_codes_version(made: Make, tmp_path: Path) -> None:
    folder = tmp_path / "methods" / "program"
    made()
    before = code_version(folder, "cpu")
    (folder / "program.py").write_text((folder / "program.py").read_text() + "\nx = 1\n")
    assert code_version(folder, "cpu") != before
