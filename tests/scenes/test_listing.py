"""`dofbench scenes`: what is here, and why something isn't a scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.scenes.listing import Listed, list_scenes


@pytest.fixture
def scene(tmp_path, write_images):
    """A folder that holds one scene, of five views, and a folder that is none."""
    root = tmp_path / "shelf" / "little"
    names = [f"{index}.png" for index in range(5)]
    write_images(root / "images", names, (20, 10))
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = range(5)
    frames = [
        {"file_path": f"images/{name}", "transform_matrix": pose.tolist()}
        for name, pose in zip(names, poses, strict=True)
    ]
    camera = {"w": 20, "h": 10, "fl_x": 22.0, "fl_y": 22.0, "cx": 10.0, "cy": 5.0}
    (root / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    (tmp_path / "shelf" / "notes").mkdir()
    return root


def given(folder):
    """What the list has for a folder, built-in scenes left out."""
    return [listed for listed in list_scenes([folder]) if Path(listed.name).is_absolute()]


def test_a_scene_and_the_folder_that_holds_it_are_listed_alike(scene):
    expected = Listed(
        str(scene), layout="nerfstudio", training=4, test=1, split="hold 8 (default)", width=20, height=10
    )
    assert [replace(listed, notes=()) for listed in given(scene)] == [expected]
    assert given(scene.parent) == given(scene)


@pytest.mark.slow
def test_a_scene_with_deleted_images_is_listed_and_is_not_whole(scene, capsys):
    (scene / "images/3.png").unlink()
    (listed,) = given(scene)
    assert not listed.problem and (listed.training, listed.test) == (3, 1)
    assert any("images/3.png" in note for note in listed.notes)
    assert app.main(["scenes", str(scene)]) == 1
    said = capsys.readouterr().out
    assert "--skip-missing" in said and "no scene" not in said


@pytest.mark.slow
def test_folders_without_a_scene(scene, capsys, tmp_path):
    folder = scene.parent / "notes"
    (listed,) = given(folder)
    assert str(folder) in listed.problem and "expected" in listed.problem
    assert app.main(["scenes", str(folder)]) == 1
    assert f"no scene: {folder}" in capsys.readouterr().out
    with pytest.raises(InputError, match="no such folder"):
        list_scenes([tmp_path / "absent"])


def test_built_in_scenes_are_readable_and_have_truth():
    built_in = list_scenes()
    assert "tabletop" in [listed.name for listed in built_in]
    assert not [listed.problem for listed in built_in if listed.problem]
    assert all(listed.depth and listed.points and listed.test for listed in built_in)


def test_a_real_scene_is_listed(real_data):
    (listed,) = given(real_data("llff_fern").resolve())
    assert (listed.layout, listed.training, listed.test, listed.points) == ("llff", 17, 3, 10091)
