"""One command from a folder of photographs to a page, as a user calls it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dofbench.content import content_folder
from dofbench.errors import InputError
from dofbench.harness.result import read_result
from dofbench.runs.settings import Runs

NAMES = tuple(f"view_{index:03d}" for index in range(4, 13))


def dofbench(folder: Path, *words: str, status: int = 0) -> str:
    """Call the command line in `folder`; returns what it printed on both streams."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "COLUMNS": "200"}
    done = subprocess.run([sys.executable, "-P", "-m", "dofbench", *words], cwd=folder, env=environment, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=600)
    assert done.returncode == status, done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nine photographs of the built-in scene in `desk`."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "desk").mkdir()
    for name in NAMES:
        shutil.copy(content_folder("datasets") / f"tabletop/images/{name}.png", folder / "desk")
    return folder


CALL = ("run", "--method", "dofgaussian", "--photographs", "desk", "--preset", "smoke", "--width", "96",
        "--set", "steps=12")


def test_a_dry_run_says_what_will_be_done_and_how_long_it_takes(desk: Path):
    said = dofbench(desk, *CALL, "--dry-run")
    assert "camera poses of 9 photographs: about" in said and "dofgaussian, seed 0: about" in said
    assert "together about" in said and not (desk / "results").exists()


def test_from_photographs_to_a_page_and_again(desk: Path):
    said = dofbench(desk, *CALL)
    place = desk / "results/photographs/desk"
    assert (place / "desk/sparse/0/points3D.bin").is_file() and (place / "desk-96/dataset.json").is_file()
    assert (place / "report/report.html").is_file() and (place / "report/leaderboard.md").is_file()
    [folder] = [file.parent for file in (desk / "results/desk").rglob("result.json")]
    result = read_result(folder)
    assert result.scores["steps"] == 12 and result.scores["photo_psnr"] > 5
    assert (folder / "model/gaussians.ply").is_file()
    assert "every 8th held back" in said
    again = dofbench(desk, *CALL)
    assert "up to date" in again and "reusing it" in again


def test_what_is_wrong_with_the_call_is_one_line(desk: Path):
    for words, said in (
        (("--photographs", "nowhere"), "no such folder or file: nowhere"),
        (("--photographs", "desk", "--data", "x"), "--data too"),
        (("--width", "96"), "the option without --photographs"),
    ):
        printed = dofbench(desk, "run", "--method", "dofgaussian", *words, status=2)
        assert said in printed and "Traceback" not in printed and len(printed.strip().splitlines()) == 1


def test_photographs_and_data_are_one_or_the_other():
    with pytest.raises(InputError, match="one of them"):
        Runs(method="dofgaussian", photographs=Path("a"), data="b")
