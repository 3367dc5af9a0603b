"""A dataset made again from its manifest."""

from __future__ import annotations

import json
import shutil

import pytest
from relisted import write_again

from dofbench.cli import app
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset


@pytest.fixture(scope="module")
def odd(scene, tmp_path_factory):
    """A dataset with as many options as possible."""
    return make_dataset(
        MakeDataset(
            scene=str(scene),
            out=tmp_path_factory.mktemp("odd") / "odd",
            hold=3,
            gamma=2.0,
            shape="5-gon",
            shape_rotation=10.0,
            assign="held-out",
            focus=(0.15, 0.9),
            test_focus=(0.5,),
            photons=500.0,
            bits=16,
            seed=4,
            linear="exr-float",
            depth=f"folder:{scene / 'depth'}",
        ),
        progress=Silent(),
    )


def test_the_same_bytes(scene, odd, dataset_folder, tmp_path, contents, capsys):
    for like, out in ((dataset_folder, tmp_path / "plain"), (dataset_folder / "dataset.json", tmp_path / "again")):
        assert app.main(["make-dataset", str(scene), "--like", str(like), "--out", str(out)]) == 0
        assert contents(out) == contents(dataset_folder)
        assert f"the same bytes as {like}" in capsys.readouterr().out
    arguments = ["--like", str(odd), "--out", str(tmp_path / "odd"), "--depth", f"folder:{scene / 'depth'}"]
    assert app.main(["make-dataset", str(scene), *arguments]) == 0
    assert contents(tmp_path / "odd") == contents(odd)


def test_a_difference_is_told(scene, dataset_folder, tmp_path, capsys):
    like = tmp_path / "like"
    like.mkdir()
    manifest = json.loads((dataset_folder / "dataset.json").read_text())
    manifest["files"]["images/v02.png"]["sha256"] = "0" * 64
    write_again(like / "dataset.json", manifest)
    assert app.main(["make-dataset", str(scene), "--like", str(like), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == f"not the bytes of {like}: images/v02.png"


def wrong_image(root, manifest):
    shutil.copy(root / "images" / "v01.png", root / "images" / "v02.png")


def wrong_depth(root, manifest):
    shutil.copy(root / "depth" / "v01.exr", root / "depth" / "v02.exr")


@pytest.mark.parametrize(
    "change, word",
    [
        (wrong_image, "another image or mask of view v02"),
        (wrong_depth, "other cameras, split, depth or points"),
        (lambda root, manifest: manifest.update(dofbench="0.0.0"), "made by dofbench 0.0.0"),
    ],
)
def test_another_scene_or_version_is_refused(write_scene, dataset_folder, tmp_path, capsys, change, word):
    root, like = write_scene(tmp_path / "planes"), tmp_path / "like"
    like.mkdir()
    manifest = json.loads((dataset_folder / "dataset.json").read_text())
    change(root, manifest)
    write_again(like / "dataset.json", manifest)
    assert app.main(["make-dataset", str(root), "--like", str(like), "--out", str(tmp_path / "out")]) == 2
    assert word in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, word",
    [
        (["--gamma", "2"], "--gamma too"),
        (["tabletop"], "2 scenes"),
        (["--depth", "splat"], "--depth too"),
    ],
)
def test_what_the_manifest_sets_is_not_for_the_caller(scene, dataset_folder, tmp_path, capsys, options, word):
    out = ["--out", str(tmp_path / "out")]
    assert app.main(["make-dataset", str(scene), *options, "--like", str(dataset_folder), *out]) == 2
    assert word in capsys.readouterr().err


def test_the_dataset_itself_is_not_made_again_over_itself(scene, dataset_folder, capsys):
    arguments = ["make-dataset", str(scene), "--like", str(dataset_folder), "--out", str(dataset_folder)]
    assert app.main(arguments) == 2
    assert "another folder" in capsys.readouterr().err
