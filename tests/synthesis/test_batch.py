"""Many datasets of one call."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.jobs import Outcome
from dofbench.core.progress import Several, Silent
from dofbench.datasets.synthesis import builder as make
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset, MakeDatasets
from dofbench.datasets.synthesis.several_datasets import planned


def folders(datasets):
    return [(dataset.scene, dataset.out) for dataset in datasets]


def test_one_dataset_goes_to_the_folder_itself(scene):
    settings = MakeDatasets(scenes=(str(scene),), out=Path("there"))
    assert folders(planned(settings)[0]) == [(str(scene), Path("there"))]
    assert folders(planned(MakeDatasets())[0]) == [("tabletop", Path("data/tabletop"))]
    (one,), _ = planned(MakeDatasets(scenes=(str(scene),), assign="fixed", focus=(0.5,), aperture=(1.0,)))
    assert one.out == Path("data/planes")


def test_scenes_times_lenses(scene):
    settings = MakeDatasets(scenes=("tabletop", str(scene)), assign="fixed", focus=(0.2, 0.8), aperture=(1.0,), seed=3)
    datasets, missing = planned(settings)
    assert not missing
    assert folders(datasets) == [
        ("tabletop", Path("data/tabletop-F0.2-A1")),
        ("tabletop", Path("data/tabletop-F0.8-A1")),
        (str(scene), Path("data/planes-F0.2-A1")),
        (str(scene), Path("data/planes-F0.8-A1")),
    ]
    assert [dataset.focus for dataset in datasets] == [(0.2,), (0.8,)] * 2
    assert {dataset.seed for dataset in datasets} == {3}


def test_two_scenes_may_not_share_a_folder(scene, tmp_path):
    shutil.copytree(scene, tmp_path / "planes")
    with pytest.raises(InputError, match="data/planes: found 2 scenes that would go there"):
        planned(MakeDatasets(scenes=(str(scene), str(tmp_path / "planes"))))


def test_scenes_of_a_named_dataset_that_are_not_here_are_told(write_scene, tmp_path):
    write_scene(tmp_path / "llff" / "fern")
    write_scene(tmp_path / "llff" / "room")
    settings = MakeDatasets(scenes=("llff",), data_root=tmp_path)
    datasets, missing = planned(settings)
    assert folders(datasets) == [("llff/fern", Path("data/llff-fern")), ("llff/room", Path("data/llff-room"))]
    assert {scene.label for scene in missing} == {
        f"llff/{name}" for name in ("flower", "fortress", "horns", "leaves", "orchids", "trex")
    }
    assert all(scene.missing for scene in missing)


@pytest.mark.slow
def test_a_scene_that_fails_does_not_stop_the_others(scene, write_scene, dataset_as_called, tmp_path, contents, capfd):
    other = write_scene(tmp_path / "other")
    (other / "images" / "v02.png").write_bytes(b"none")
    out = tmp_path / "out"
    assert app.main(["make-dataset", str(other), str(scene), "--out", str(out)]) == 1
    printed = capfd.readouterr()
    assert contents(out / "planes") == contents(dataset_as_called)
    assert printed.out == f"{out / 'planes'}: 6 views\n"
    (line,) = (line for line in printed.err.splitlines() if "v02.png" in line)
    assert line.startswith(f"{out / 'other'}: {other / 'images/v02.png'}: found ")
    assert "Traceback" not in printed.err


def test_a_sibling_lends_its_sharp_images_and_depth(scene, tmp_path, contents, monkeypatch):
    def settings(focus, name, **options):
        return MakeDataset(
            scene=str(scene), assign="fixed", focus=focus, aperture=(1.0,), out=tmp_path / name, **options
        )

    first = make_dataset(settings((0.2,), "first"), progress=Silent())
    alone = make_dataset(settings((0.8,), "alone"), progress=Silent())
    another = make_dataset(settings((0.8,), "narrow", width=64), progress=Silent())
    with monkeypatch.context() as patch:
        patch.setattr(make, "encoded", None)
        lent = make.make(settings((0.8,), "lent"), Silent(), sibling=first)
        with pytest.raises(TypeError):
            make.make(settings((0.8,), "not lent"), Silent(), sibling=another)
    assert contents(lent) == contents(alone)
    damaged = first / "all_in_focus" / "v01.png"
    damaged.write_bytes(damaged.read_bytes()[:-1])
    assert contents(make.make(settings((0.8,), "mended"), Silent(), sibling=first)) == contents(alone)


def test_progress_names_what_is_done_and_how_long_it_takes(capsys, monkeypatch):
    now = iter(range(0, 1000, 10))
    monkeypatch.setattr("dofbench.core.progress.time.monotonic", lambda: float(next(now)))
    several = Several(total=3, workers=2, interval=5)
    several.started("a")
    several.started("b")
    several.reported("a", ("blur", 2, 5))
    several.ended(Outcome("a", "a: 5 views"))
    several.started("c")
    several.ended(Outcome("b", problem="b.png: found x, expected y"))
    several.ended(Outcome("c", "c: 5 views"))
    printed = capsys.readouterr()
    assert printed.out == "a: 5 views\nc: 5 views\n"
    lines = printed.err.splitlines()
    assert lines[0] == "0 of 3 datasets; a: blur 2 of 5; b: starting"
    assert lines[1].startswith("1 of 3 datasets, about ") and lines[1].endswith(" s left; b: starting")
    assert lines[2] == "b: b.png: found x, expected y"
    assert lines[-1] == "3 of 3 datasets"
