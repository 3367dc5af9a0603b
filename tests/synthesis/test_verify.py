"""check_dataset finds what is wrong: each fault is put in on purpose."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
from relisted import write_again

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file, write_json
from dofbench.core.images import read_image, write_png
from dofbench.datasets.synthesis import check_dataset


@pytest.fixture
def folder(dataset_folder, tmp_path):
    """A copy to spoil."""
    return shutil.copytree(dataset_folder, tmp_path / "copy")


def seal(folder):
    """Bring the manifest's checksums up to date, as someone would who hides a change."""
    manifest = json.loads((folder / "dataset.json").read_text())
    for name, record in manifest["files"].items():
        record.update(sha256=sha256_file(folder / name), size=(folder / name).stat().st_size)
    write_again(folder / "dataset.json", manifest)


def change_lens(folder, view, **values):
    lenses = json.loads((folder / "lens.json").read_text())
    lenses["views"][view].update(values)
    write_json(folder / "lens.json", lenses)
    seal(folder)


def test_nothing_wrong(folder):
    assert check_dataset(folder) == []


def test_a_flipped_bit(folder):
    data = bytearray((folder / "images_linear/v02.exr").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "images_linear/v02.exr").write_bytes(data)
    assert check_dataset(folder) == ["images_linear/v02.exr: content differs from its checksum in dataset.json"]


def test_a_missing_a_longer_and_an_extra_file(folder):
    (folder / "depth/v01.exr").unlink()
    (folder / "README.md").write_text((folder / "README.md").read_text() + "\nmore")
    (folder / "notes.txt").write_text("mine")
    problems = check_dataset(folder)
    assert [problem.split(":")[0] for problem in problems] == ["README.md", "depth/v01.exr", "notes.txt"]


def test_a_file_taken_out_of_the_manifest_too(folder):
    manifest = json.loads((folder / "dataset.json").read_text())
    del manifest["files"]["images/v01.png"]
    write_again(folder / "dataset.json", manifest)
    (folder / "images/v01.png").unlink()
    assert "images/v01.png: not listed in dataset.json" in check_dataset(folder)


@pytest.mark.parametrize(
    "values, word",
    [
        ({"aperture": 0.9}, "k_px"),
        ({"focus": 0.45}, "focus_scene"),
        ({"k_px": 3.0}, "k_px"),
        ({"max_coc_px": 0.1}, "max_coc_px"),
        ({"aperture_scene": 1.0}, "aperture_scene"),
    ],
)
def test_a_lens_value_that_does_not_fit(folder, values, word):
    change_lens(folder, 1, **values)
    problems = check_dataset(folder)
    assert problems and all(problem.startswith("lens.json: view v01") for problem in problems)
    assert any(word in problem for problem in problems)


def test_a_lens_file_that_is_none(folder):
    change_lens(folder, 2, focus="near", colour=3)
    (problem,) = check_dataset(folder)
    assert "views.2.focus" in problem and "views.2.colour" in problem and "\n" not in problem


def test_an_image_that_is_not_the_blur(folder):
    """Every checksum fits, but the image is not what the lens gives."""
    lenses = json.loads((folder / "lens.json").read_text())["views"]
    name = max(lenses, key=lambda view: view["max_coc_px"])["name"]
    write_png(folder / f"images/{name}.png", read_image(folder / f"all_in_focus/{name}.png"))
    seal(folder)
    (problem,) = check_dataset(folder)
    assert problem.startswith(f"images/{name}.png:") and "dB" in problem


def test_a_test_image_among_the_training_images(folder):
    shutil.copy(folder / "all_in_focus/v00.png", folder / "all_in_focus/v01.png")
    seal(folder)
    assert any("view v00, to test on: the same photograph as view v01" in problem for problem in check_dataset(folder))


def test_a_split_that_the_cameras_do_not_have(folder):
    change_lens(folder, 1, split="test")
    (problem,) = check_dataset(folder)
    assert "another split" in problem and "v01" in problem


def test_another_pose_in_one_layout(folder):
    cameras = np.load(folder / "poses_bounds.npy")
    np.save(folder / "poses_bounds.npy", cameras + 1)
    assert check_dataset(folder) == ["poses_bounds.npy: content differs from its checksum in dataset.json"]


def test_no_manifest_to_check_against(folder):
    (folder / "dataset.json").unlink()
    with pytest.raises(InputError, match=r"no dataset\.json"):
        check_dataset(folder)
