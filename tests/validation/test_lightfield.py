"""Light fields made of planes whose disparity is known: what is found and added up, against it."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from tolerances import SWEPT_DISPARITY

from dofbench.errors import InputError
from dofbench.images import encode, write_png
from dofbench.validation import planes, run
from dofbench.validation.lightfield import GRID, photographs, read_lightfield, sweep
from dofbench.validation.settings import ValidateRenderer

STEPS, FAR, NEAR = 2, -0.4, 0.4


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Views of two walls, disparity 0.4 far and -0.4 near: nearer things move against the camera."""
    path = tmp_path_factory.mktemp("field")
    before = planes.WIDTH, planes.HEIGHT
    planes.WIDTH, planes.HEIGHT = 160, 120
    try:
        scene = (planes.Plane(1, 4.0, "all", 0.0), planes.Plane(2, 4.0, "discs", 1.0))
        for row in range(-STEPS, STEPS + 1):
            for column in range(-STEPS, STEPS + 1):
                # The lens' points are the views; a point of signed radius s moves by s per unit, here -0.4 to 0.4.
                image, _ = planes._view(scene, NEAR - FAR, 0.5, -column, -row)
                write_png(path / "views" / f"{row + 5:02d}_{column + 5:02d}.png", encode(np.clip(image, 0, 1)))
        _, radius = planes._view(scene, NEAR - FAR, 0.5, 0, 0)
    finally:
        planes.WIDTH, planes.HEIGHT = before
    np.save(path / "disparity.npy", -radius)
    (path / GRID).write_text(json.dumps({
        "centre": "05_05", "disparity_px_per_view_step": {"horizontal": [FAR, NEAR], "vertical": [FAR, NEAR]}}))
    return path


def test_the_sweep_finds_the_disparity(folder):
    found, truth = sweep(read_lightfield(folder)), np.load(folder / "disparity.npy")
    error = np.abs(found - truth)[6:-6, 6:-6]
    assert np.median(error) < SWEPT_DISPARITY
    # Smoothing over 11 pixels widens what is in front.
    assert np.mean(error > 0.1) < 0.15


def test_photographs_know_which_side_is_near(folder):
    made = list(photographs(read_lightfield(folder)))
    assert len(made) == 3 * (STEPS - 1)
    truth = np.load(folder / "disparity.npy")
    for photograph in made:
        signed = photograph.signed_radius
        assert np.median(signed[truth < 0]) > np.median(signed[truth > 0])
        # Thirteen views within two steps: a disc of radius sqrt(13 / pi).
        expected = math.sqrt(13 / math.pi) * 0.8
        assert np.median(signed[truth < 0]) - np.median(signed[truth > 0]) == pytest.approx(expected, rel=0.1)


def test_the_command_writes_its_tables(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "PLANE_RADII", ())
    out = run.validate_renderer(ValidateRenderer((folder,), tmp_path / "out"))
    with (out / "renderer.csv").open() as file:
        rows = list(csv.DictReader(file))
    by_variant = {row["variant"]: float(row["psnr"]) for row in rows if row["region"] == "all"}
    assert by_variant["scatter"] > by_variant["no blur"]
    text = (out / "renderer.md").read_text()
    assert "## light field" in text and "| layered, 16 |" in text and str(folder.parent) not in text
    assert len(list((out / "pictures").glob("*.png"))) == 3


@pytest.mark.parametrize(("damage", "word"), [
    (lambda path: (path / GRID).unlink(), "no grid.json"),
    (lambda path: (path / GRID).write_text("{}"), "no centre"),
    (lambda path: (path / "views" / "05_05.png").unlink(), "no view 05_05"),
    (lambda path: (path / "views" / "03_04.png").unlink(), "gaps"),
])
def test_a_folder_that_is_no_light_field(folder, tmp_path, damage, word):
    copy = tmp_path / "copy"
    (copy / "views").mkdir(parents=True)
    for file in folder.rglob("*.*"):
        (copy / file.relative_to(folder)).write_bytes(file.read_bytes())
    damage(copy)
    with pytest.raises(InputError, match=word) as caught:
        read_lightfield(copy)
    assert "\n" not in str(caught.value)


def test_a_wrong_folder_is_one_line_and_status_2(tmp_path):
    done = subprocess.run([sys.executable, "-m", "dofbench", "validate-renderer", str(tmp_path)],
                          capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and GRID in done.stderr
