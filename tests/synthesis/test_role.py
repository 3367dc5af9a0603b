"""The role of a scene in its dataset: in the manifest, the README and the check."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from relisted import write_again
from small_dataset import write_dataset as write_fake

from dofbench.core.evidence import PHOTOGRAPHER_SAYS, ROLE_SAYS
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.synthesis import check_dataset, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset


@pytest.fixture(scope="module")
def report_scene(tmp_path_factory: pytest.TempPathFactory, write_scene: Callable[..., Path]) -> Path:
    """The dataset of a scene that lies where a report scene of a named dataset does."""
    folder = tmp_path_factory.mktemp("report")
    scene = write_scene(folder / "llff_room")
    return make_dataset(MakeDataset(scene=str(scene), aperture=(1.0,), focus=(0.5,), out=folder / "data"))


def manifest(folder: Path) -> dict:
    return json.loads((folder / "dataset.json").read_text())


def test_a_dataset_states_its_role_and_what_photographed_it(report_scene: Path) -> None:
    record = manifest(report_scene)
    assert (record["source"]["role"], record["source"]["role_by"], record["version"]) == ("report", "llff/room", 4)
    dataset = Dataset.load(report_scene)
    assert (dataset.role, dataset.role_by, dataset.photographer) == ("report", "llff/room", "scatter")
    text = (report_scene / "README.md").read_text()
    assert ROLE_SAYS["report"] in text and "`datasets/llff.toml`" in text and PHOTOGRAPHER_SAYS["scatter"] in text
    assert check_dataset(report_scene) == []


def test_a_scene_of_one_s_own_has_none(dataset_folder: Path) -> None:
    record = manifest(dataset_folder)
    assert not {"role", "role_by"} & record["source"].keys()
    dataset = Dataset.load(dataset_folder)
    assert (dataset.role, dataset.role_by) == (None, "")
    text = (dataset_folder / "README.md").read_text()
    assert ROLE_SAYS[None] in text and not any(ROLE_SAYS[role] in text for role in ("report", "development"))


def test_photographs_of_unknown_lens_say_it_too(tmp_path: Path, write_scene: Callable[..., Path]) -> None:
    scene = write_scene(tmp_path / "shallow_chessking", depth=False)
    out = make_dataset(MakeDataset(scene=str(scene), photographs="shallow", out=tmp_path / "data"))
    dataset = Dataset.load(out)
    assert (dataset.role, dataset.role_by, dataset.photographer) == ("development", "real-lens/chessking", "unknown")
    text = (out / "README.md").read_text()
    assert ROLE_SAYS["development"] in text and PHOTOGRAPHER_SAYS["unknown"] in text
    assert manifest(out)["version"] == 4 and check_dataset(out) == []


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"role": "development"}, "role development, and datasets/llff.toml says report of llff/room"),
        ({"role_by": "llff/fern"}, "role report, and datasets/llff.toml says development of llff/fern"),
        ({"role": None}, "role not stated, and yet by llff/room"),
    ],
)
def test_another_role_than_the_files_is_a_problem(report_scene: Path, tmp_path: Path, changed: dict, said: str) -> None:
    folder = shutil.copytree(report_scene, tmp_path / "copy")
    record = manifest(folder)
    record["source"].update(changed)
    write_again(folder / "dataset.json", record)
    assert check_dataset(folder) == [f"dataset.json: {said}"]


def test_a_rendered_scene_s_recipe_and_seed_must_fit_its_role(tmp_path: Path) -> None:
    said = "role development, and report/attic says report of recipe attic, seed 20261104"
    wrong = write_fake(tmp_path / "wrong", role="development", role_by="rendered", renderer="thinlens")
    assert any(said in problem for problem in check_dataset(wrong))
    right = write_fake(tmp_path / "right", role="report", role_by="report/attic", renderer="thinlens")
    assert not any("role" in problem for problem in check_dataset(right))


def test_an_unknown_role_is_refused(report_scene: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(report_scene, tmp_path / "copy")
    record = manifest(folder)
    record["source"]["role"] = "tuning"
    write_again(folder / "dataset.json", record)
    with pytest.raises(Exception, match="source.role: Input should be 'development' or 'report'"):
        Dataset.load(folder)
