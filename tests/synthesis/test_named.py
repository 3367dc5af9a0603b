"""make-dataset of named scenes: what is known of them is taken, and said, unless the user says otherwise."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_up import frontal

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.images import write_png
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import check_dataset, make_dataset
from dofbench.datasets.synthesis.builder import find_scene, read_scene
from dofbench.datasets.synthesis.dataset_options import MakeDataset, MakeDatasets
from dofbench.datasets.synthesis.several_datasets import planned
from dofbench.scenes.export import write_poses_bounds

pytestmark = pytest.mark.usefixtures("one_torch_thread")


@pytest.fixture
def shelf(tmp_path: Path, write_scene: Callable[..., Path]) -> Path:
    """A data root with a rendered scene."""
    folder = write_scene(tmp_path / "shelf" / "scenes" / "planes")
    (folder / "scene.json").write_text(json.dumps({"schema": "dofbench-scene", "licence": "CC0-1.0"}))
    return tmp_path / "shelf"


def test_a_named_scene_becomes_a_dataset_that_its_own_command_makes_again(
    shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, contents: Callable[[Path], dict[str, bytes]]
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = MakeDataset(scene="rendered/planes", data_root=shelf, width=64)
    folder = make_dataset(settings, progress=Silent())
    assert folder == Path("data/rendered-planes") and check_dataset(folder) == []
    manifest = json.loads((folder / "dataset.json").read_text())
    assert manifest["command"] == "dofbench make-dataset rendered/planes --width 64 --layout nerfstudio"
    assert manifest["command"] in (folder / "README.md").read_text()
    assert manifest["name"] == "rendered-planes"
    again = app.parse(shlex.split(manifest["command"])[1:])
    (again,), _ = planned(replace(again, data_root=shelf, out=tmp_path / "again"))
    again = make_dataset(again, progress=Silent())
    assert contents(again) == contents(folder)
    (short,), _ = planned(MakeDatasets(scenes=("planes",), width=64, data_root=shelf, out=tmp_path / "short"))
    assert contents(make_dataset(short, progress=Silent())) == contents(folder)


def write_poses(root: Path, count: int) -> None:
    root.mkdir(parents=True)
    cameras = [frontal(4032, 3024, 3500.0)] * count
    write_poses_bounds(root / "poses_bounds.npy", cameras, np.tile([1.0, 9.0], (count, 1)))


def write_photographs(folder: Path, count: int, size: tuple[int, int]) -> None:
    write_png(folder / "00.png", np.full((size[1], size[0], 3), 0.5, np.float32))
    for index in range(1, count):
        (folder / f"{index:02d}.png").hardlink_to(folder / "00.png")


@pytest.mark.parametrize(
    ("options", "width", "hold", "layout"),
    [
        ({}, 504, 8, "llff"),
        ({"width": 300}, 300, 8, "llff"),
        ({"images": "images_4"}, None, 8, "llff"),
        ({"hold": 5}, 504, 5, "llff"),
    ],
)
def test_defaults_of_the_dataset_unless_the_user_says_otherwise(
    tmp_path: Path, options: dict, width: int | None, hold: int, layout: str
) -> None:
    write_poses(tmp_path / "llff_trex", 17)
    write_photographs(tmp_path / "llff_trex" / "images_8", 17, (504, 378))
    write_photographs(tmp_path / "llff_trex" / "images_4", 17, (1008, 756))
    settings = MakeDataset(scene="dof-gaussian/trex", data_root=tmp_path, **options)
    scene, used = read_scene(find_scene(settings), settings)
    assert (used.width, used.hold, used.layout, used.scene) == (width, hold, layout, "dof-gaussian/trex")
    assert scene.views[0].camera.width == (width or 1008)
    assert sum(view.split == "test" for view in scene.views) == len(range(0, 17, hold))


def test_a_triplet_scene_is_shallow_unless_its_sharp_photographs_are_asked_for(tmp_path: Path) -> None:
    root = tmp_path / "dof_nerf" / "desk"
    write_poses(root, 10)
    for stack in ("f11", "f4_bak", "f4_obj"):
        write_photographs(root / "images_8" / stack, 10, (84, 63))
    settings = MakeDataset(scene="dof-nerf/desk", data_root=tmp_path)
    assert read_scene(find_scene(settings), settings)[0].photographs == "shallow"
    settings = replace(settings, images="f11")
    scene, used = read_scene(find_scene(settings), settings)
    assert {view.source.parent.name for view in scene.views} == {"f11"} and scene.photographs == "all-in-focus"
    assert (used.images, used.hold, used.layout, scene.name) == ("f11", 9, "dofnerf", "dof-nerf-desk")


def test_several_scenes_are_not_taken_for_one(tmp_path: Path) -> None:
    for name in ("fern", "trex"):
        (tmp_path / f"llff_{name}").mkdir()
    with pytest.raises(InputError, match="llff: found 2 scenes, expected one of llff/fern, llff/trex"):
        find_scene(MakeDataset(scene="llff", data_root=tmp_path))


@pytest.mark.parametrize("text", ["llff", "llff/fern", "llff/nothing", "fern"])
def test_what_is_not_here_is_one_line(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["make-dataset", text, "--data-root", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"dofbench: {text}: found ") and line.count("\n") == 1 and "llff" in line
    assert not (tmp_path / "out").exists()


def test_a_real_scene_by_name(real_data: Callable[[str], Path]) -> None:
    root = real_data("llff_fern").parent
    settings = MakeDataset(scene="llff/fern", data_root=root)
    scene, used = read_scene(find_scene(settings), settings)
    assert (scene.name, len(scene.views), scene.views[0].camera.width) == ("llff-fern", 20, 504)
    assert used.command(used.scene) == "dofbench make-dataset llff/fern --width 504 --hold 8 --layout llff"
