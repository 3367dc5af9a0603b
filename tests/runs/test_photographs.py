"""One command from a folder of photographs to a page, as a user calls it."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import pytest
from markupsafe import escape

from dofbench.cli import app
from dofbench.cli.from_photographs import Own, find_own, outlook
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError
from dofbench.evaluation.results.result import read_result
from dofbench.running.run_options import Runs
from dofbench.scenes import load_scene
from dofbench.scenes.export import write_transforms

NAMES = tuple(f"view_{index:03d}" for index in range(4, 13))


def dofbench(folder: Path, *words: str, status: int = 0) -> str:
    """Call the command line in `folder`; returns what it printed on both streams."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-P", "-m", "dofbench", *words],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=600,
    )
    assert done.returncode == status, done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nine photographs of the built-in scene in `my desk`, their names with spaces like a telephone's."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "my desk").mkdir()
    for name in NAMES:
        shutil.copy(
            content_folder("datasets") / f"tabletop/images/{name}.png",
            folder / "my desk" / f"{name.replace('_', ' ')}.png",
        )
    return folder


CALL = (
    "run",
    "--method",
    "dofgaussian",
    "--photographs",
    "my desk",
    "--preset",
    "smoke",
    "--width",
    "96",
    "--set",
    "steps=12",
)


@pytest.mark.slow
def test_a_dry_run_says_what_will_be_done_and_how_long_it_takes(desk: Path):
    said = dofbench(desk, *CALL, "--dry-run")
    assert "camera poses and points of 9 photographs: about" in said and "dofgaussian, seed 0: about" in said
    assert "together about" in said and not (desk / "results").exists()


def own(source: Path, views: int = 40, size: tuple[int, int] = (3000, 2000), **changes) -> Own:
    """A fake of the user's photographs."""
    return dataclasses.replace(Own(source, source / "place", "photographs", views, size), **changes)


def seconds(lines: list[str], start: str) -> float:
    """The rest of the output line that starts with these words."""
    [line] = [line for line in lines if line.startswith(start)]
    number, unit = re.search(r"about (\d+) (s|min)", line).groups()
    return float(number) * (60 if unit == "min" else 1)


def test_the_time_said_before_goes_by_what_is_there(tmp_path: Path):
    runs = Runs(method="dofgaussian", photographs=tmp_path).cells()
    wide, high = (outlook(own(tmp_path, size=size), runs, 504) for size in ((4000, 3000), (3000, 4000)))
    # At one width an upright photograph has nearly twice the pixels.
    assert seconds(high, "dofgaussian") > 1.3 * seconds(wide, "dofgaussian")
    # Images aren't enlarged, and for poses they are shrunk to 1600 pixels.
    small = outlook(own(tmp_path, size=(320, 240)), runs, None)
    assert any("320 px wide" in line for line in small)
    assert seconds(small, "dofgaussian") < seconds(wide, "dofgaussian")
    motion = [seconds(outlook(own(tmp_path, size=(width, width)), runs, None), "camera") for width in (1600, 6400)]
    assert motion[0] == motion[1]
    # A video is decoded as well; what is there already, takes no time.
    video = own(tmp_path, kind="video", items=3000)
    assert seconds(outlook(video, runs, 504), "frames, camera") > seconds(outlook(own(tmp_path), runs, 504), "camera")
    there = own(tmp_path)
    there.scene.mkdir(parents=True)
    (there.scene / "reconstruct.json").touch()
    [line] = [line for line in outlook(there, runs, 504) if line.startswith("camera")]
    assert "there already" in line and "about" not in line
    assert "those of the scene" in outlook(own(tmp_path, kind="scene"), runs, 504)[0]


def test_two_folders_whose_names_differ_behind_a_dot_are_two(desk: Path, tmp_path: Path):
    for name in ("a trip.2025", "a trip.2026"):
        shutil.copytree(desk / "my desk", tmp_path / name)
    first, second = (find_own(tmp_path / name, tmp_path / "results") for name in ("a trip.2025", "a trip.2026"))
    assert first.scene != second.scene and first.scene.name == "a trip.2025" and first.views == 9


def test_smaller_copies_are_not_counted(desk: Path, tmp_path: Path):
    for name in ("images", "images_2"):
        shutil.copytree(desk / "my desk", tmp_path / "two" / name)
    assert find_own(tmp_path / "two", tmp_path / "results").views == 9


def test_a_scene_without_points_keeps_its_poses(desk: Path, tmp_path: Path):
    scene = load_scene(content_folder("datasets") / "tabletop")
    views = [view for view in scene.views if view.name in NAMES]
    (tmp_path / "posed/images").mkdir(parents=True)
    for view in views:
        shutil.copy(view.source, tmp_path / "posed/images")
    write_transforms(
        tmp_path / "posed/transforms.json",
        [f"images/{view.source.name}" for view in views],
        [view.camera for view in views],
    )
    found = find_own(tmp_path / "posed", tmp_path / "results")
    assert found.kind == "poses" and found.views == 9
    runs = Runs(method="dofgaussian", photographs=found.source).cells()
    assert outlook(found, runs, 96)[0].startswith("points, the poses being known, of 9 photographs: about")
    with_points = find_own(content_folder("datasets") / "tabletop", tmp_path / "results")
    assert with_points.kind == "scene" and with_points.scene == with_points.source


def test_a_video_is_looked_at_before_anything_is_promised(desk: Path, tmp_path: Path):
    writer = cv2.VideoWriter(str(tmp_path / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (64, 48))
    for file in sorted((desk / "my desk").glob("*.png")):
        writer.write(cv2.resize(cv2.imread(str(file)), (64, 48)))
    writer.release()
    found = find_own(tmp_path / "walk.avi", tmp_path / "results")
    assert (found.kind, found.views, found.size, found.items) == ("video", 9, (64, 48), 9)
    assert found.scene.name == "walk"


@pytest.mark.slow
def test_from_photographs_to_a_page_and_again(desk: Path):
    said = dofbench(desk, *CALL, "--verbose")
    place = desk / "results/photographs/my desk"
    assert (place / "my desk/sparse/0/points3D.bin").is_file() and (place / "my desk-96/dataset.json").is_file()
    assert (place / "report/report.html").is_file() and (place / "report/leaderboard.md").is_file()
    [folder] = [file.parent for file in (desk / "results/my desk").rglob("result.json")]
    result = read_result(folder)
    assert result.scores["steps"] == 12 and result.scores["photo_psnr"] > 5
    assert (folder / "model/gaussians.ply").is_file()
    assert "every 8th held out" in said
    # The scene is called after the folder, and the plan's decisions are on the terminal and on the page.
    assert result.spec.dataset == "my desk"
    reason = next(stage["reason"] for stage in result.plan["stages"] if stage["name"] == "sparse_depth")
    assert f"sparse depth: on ({reason})" in said
    assert any(str(escape(reason)) in page.read_text() for page in (place / "report").rglob("*.html"))
    # The page doesn't include other results below the same folder.
    other = desk / "results/another" / folder.name
    shutil.copytree(folder, other)
    again = dofbench(desk, *CALL, "--verbose")
    assert "up to date" in again and "cached result" in again and "there already" in again
    assert (place / "report/leaderboard.md").read_text().count(f"| {result.key[:8]} |") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--photographs", "nowhere"), "no such folder or file: nowhere"),
        (("--photographs", "my desk", "--data", "x"), "--data too"),
        (("--width", "96"), "the option without --photographs"),
        (("--photographs", "one", "--dry-run"), "one: found one photograph, expected at least 3"),
        (("--photographs", "none", "--dry-run"), "none: found 0 photographs, expected at least 3"),
        (("--photographs", "notes.txt", "--dry-run"), "a file that is no video"),
        (("--photographs", "my desk", "--set", "nonsense=1"), "option: found 'nonsense'"),
        (("--photographs", "my desk", "--inputs", "all-in-focus"), "--set lens=false disables the lens"),
        (("--photographs", "my desk", "--out", "my desk/results"), "a folder outside of my desk"),
    ],
)
def test_what_is_wrong_with_the_call_is_one_line(
    desk: Path,
    words: tuple[str, ...],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(desk)
    Path("notes.txt").touch()
    for name, count in (("one", 1), ("none", 0)):
        Path(name).mkdir(exist_ok=True)
        for file in sorted(Path("my desk").glob("*.png"))[:count]:
            shutil.copy(file, name)
    assert app.main(["run", "--method", "dofgaussian", *words]) == 2
    printed = capsys.readouterr()
    assert said in printed.err and len(printed.err.strip().splitlines()) == 1 and not printed.out


def test_photographs_and_data_are_one_or_the_other():
    with pytest.raises(InputError, match="one of them"):
        Runs(method="dofgaussian", photographs=Path("a"), data="b")
