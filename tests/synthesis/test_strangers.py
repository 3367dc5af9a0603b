"""A dataset folder that a stranger made: nothing outside it is deleted, written or copied from."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from relisted import edit_json

from dofbench.cli import app
from dofbench.core.errors import InputError
from dofbench.core.progress import Silent
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.synthesis import make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset

OUTSIDE = ["../victim.txt", "images/../../victim.txt", "a\\..\\..\\victim.txt", "ABSOLUTE", "a\nb", "a\0b", "x" * 201]
MISSING = {"sha256": "0" * 64, "size": 3}


@pytest.fixture
def folder(dataset_folder: Path, tmp_path: Path) -> Path:
    (tmp_path / "victim.txt").write_text("precious")
    return shutil.copytree(dataset_folder, tmp_path / "theirs")


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_manifest_that_lists_a_file_outside(scene: Path, folder: Path, capsys, name: str) -> None:
    name = name.replace("ABSOLUTE", str(folder.parent / "victim.txt"))
    edit_json(folder / "dataset.json", lambda manifest: manifest["files"].update({name: MISSING}))
    for call in (["make-dataset", str(scene), "--out", str(folder)], ["check", str(folder)]):
        assert app.main(call) == app.WRONG_CALL
        assert capsys.readouterr().err.count("\n") == 1
    assert (folder.parent / "victim.txt").read_text() == "precious"


@pytest.mark.parametrize(
    "change",
    [
        lambda manifest: manifest.update(name="../../evil"),
        lambda manifest: manifest["source"]["images"][0].update(view="../../../evil"),
        lambda manifest: manifest["depth"]["views"][0].update(view="/evil"),
    ],
)
def test_names_of_a_manifest_that_lead_outside(scene: Path, folder: Path, tmp_path: Path, change) -> None:
    edit_json(folder / "dataset.json", change)
    for read in (
        lambda: Dataset.load(folder),
        lambda: make_dataset(MakeDataset(scene=str(scene), out=tmp_path / "new", reuse=folder), progress=Silent()),
    ):
        with pytest.raises(InputError, match=r"dataset\.json"):
            read()
    assert not list(tmp_path.rglob("evil*"))


def test_a_view_of_lens_json_that_leads_outside(folder: Path) -> None:
    edit_json(folder / "lens.json", lambda lenses: lenses["views"][0].update(name="../evil"))
    with pytest.raises(InputError):
        Dataset.load(folder)


def test_a_file_of_the_users_in_the_folder_stays(scene: Path, folder: Path) -> None:
    """The manifest calls it a damaged file of its own."""
    (folder / "notes.txt").write_text("mine")
    edit_json(folder / "dataset.json", lambda manifest: manifest["files"].update({"notes.txt": MISSING}))
    make_dataset(MakeDataset(scene=str(scene), out=folder), progress=Silent())
    assert (folder / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["images", "sparse/0", ".work"])
def test_a_link_to_a_folder_outside_is_not_written_through(
    scene: Path, folder: Path, tmp_path: Path, name: str
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "v00.png").write_text("precious")
    shutil.rmtree(folder / name, ignore_errors=True)
    (folder / name).symlink_to(outside)
    with pytest.raises(InputError, match="a link to"):
        make_dataset(MakeDataset(scene=str(scene), out=folder), progress=Silent())
    assert [path.read_text() for path in outside.iterdir()] == ["precious"]


def test_a_linked_picture_is_replaced_and_its_target_stays(scene: Path, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "victim.png").write_text("precious")
    (folder / "images" / "v01.png").unlink()
    (folder / "images" / "v01.png").symlink_to(tmp_path / "victim.png")
    make_dataset(MakeDataset(scene=str(scene), out=folder), progress=Silent())
    assert (tmp_path / "victim.png").read_text() == "precious"
    assert not (folder / "images" / "v01.png").is_symlink()
