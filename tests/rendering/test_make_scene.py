"""The command as a user calls it: the folder's contract, resuming, and refusals in one line."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from called import dofbench, killed
from made_up import frontal
from tolerances import FLOAT16_VALUE, FLOAT64_VALUE, LEVEL_8BIT

from dofbench.cli import app
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr
from dofbench.core.lens import DisparityRange, Lens
from dofbench.optics.tone import encode
from dofbench.scenes import load_scene
from dofbench.scenes.depth.disparity import scene_range
from dofbench.scenes.procedural import sparse_points

SMALL = "--views 3 --width 40 --height 30 --samples 8 --lens-views 1 --lens-samples 8 --focus 0.2,0.8 --aperture 1"


def call(out, *more, recipe="corridor"):
    """Exit status of make-scene with small images, `more` in place of those options."""
    words = iter(SMALL.split())
    small = [word for option in words for word in (option, next(words)) if option not in more]
    return app.main(["make-scene", recipe, "--out", str(out), *small, *more])


def record(folder):
    """scene.json."""
    return json.loads((folder / "scene.json").read_text())


@pytest.fixture(scope="module")
def made(variant, tmp_path_factory):
    """A finished scene. Nobody writes to it."""
    out = tmp_path_factory.mktemp("scenes") / "corridor"
    assert call(out) == 0
    return out


def test_the_folder_holds_what_it_says(made):
    entries = record(made)
    names = [f"view_{index:03d}" for index in range(3)]
    expected = {"scene.json", "transforms.json"}
    expected |= {
        f"{part}/{name}"
        for part, suffix in (("images", "png"), ("images_linear", "exr"), ("depth", "exr"))
        for name in (f"{view}.{suffix}" for view in names)
    }
    expected |= {"lens/view_000_a1_f0.2.exr", "lens/view_000_a1_f0.8.exr"}
    listed = dict(reversed(line.split("  ", 1)) for line in (made / "SHA256SUMS").read_text().splitlines())
    assert {name for name in listed if not name.startswith("sparse/0/")} == expected
    assert {name: sha256_file(made / name) for name in listed} == listed
    assert (entries["schema"], entries["version"]) == ("dofbench-scene", 1)
    assert (entries["recipe"], entries["seed"]) == ("corridor", 0)
    assert [entry["view"] for entry in entries["images"]] == names
    assert all(entry["noise_rms_linear"] > 0 for entry in entries["images"] + entries["lens_images"])
    assert "dofbench make-scene corridor --views 3" in (made / "README.md").read_text()


def test_the_scene_is_read_with_its_exact_depth(made):
    scene = load_scene(made)
    assert [view.name for view in scene.views] == ["view_000", "view_001", "view_002"]
    for view in scene.views:
        assert view.depth is not None and view.image().shape == (30, 40, 3)
        np.testing.assert_array_equal(view.depth(), read_exr(made / "depth" / f"{view.name}.exr"))
        linear = read_exr(made / "images_linear" / f"{view.name}.exr")
        assert np.abs(encode(np.clip(linear, 0, 1)) - view.image()).max() <= 0.5 * LEVEL_8BIT + FLOAT16_VALUE


def test_views_that_see_no_point_have_no_depth_errors():
    """As few small views may end: triangulation finds points, but none in some of them."""
    model = sparse_points._posed([frontal(8, 6, 9.0)], ["view.png"], None)
    assert sparse_points.depth_errors([frontal(8, 6, 9.0)], model, [np.ones((6, 8))]).shape == (0,)


def test_lenses_are_stated_in_both_units(made):
    entries = record(made)
    found = scene_range(lambda: (read_exr(path) for path in sorted((made / "depth").iterdir())))
    assert entries["disparity_range"] == pytest.approx([found.q_min, found.q_max], rel=FLOAT64_VALUE)
    for entry in entries["lens_images"]:
        lens = Lens(entry["aperture"], entry["focus"]).physical(DisparityRange(*entries["disparity_range"]), 40)
        assert entry["aperture_scene"] == pytest.approx(lens.aperture, rel=FLOAT64_VALUE)
        assert entry["focus_scene"] == pytest.approx(lens.focus_depth, rel=FLOAT64_VALUE)
        assert read_exr(made / entry["image"]).shape == (30, 40, 3)


def test_a_complete_scene_is_left_alone_and_continued(made, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in made.rglob("*")}
    assert call(made) == 0
    assert {path: path.stat().st_mtime_ns for path in made.rglob("*")} == before
    # Two files and the sums lost: made again, byte for byte, and a new lens joins the others.
    import shutil

    copy = shutil.copytree(made, tmp_path / "copy")
    (copy / "SHA256SUMS").unlink()
    (copy / "lens" / "view_000_a1_f0.8.exr").unlink()
    (copy / "images" / "view_001.png").unlink()
    assert call(copy) == 0
    assert (copy / "SHA256SUMS").read_text() == (made / "SHA256SUMS").read_text()
    assert call(copy, "--aperture", "0.5,1") == 0
    assert [entry["aperture"] for entry in record(copy)["lens_images"]] == [0.5, 0.5, 1, 1]
    assert sha256_file(copy / "lens/view_000_a1_f0.2.exr") == sha256_file(made / "lens/view_000_a1_f0.2.exr")


def test_depth_bits_round_to_nearest(made, variant, tmp_path):
    assert call(tmp_path / "coarse", "--depth-bits", "8", "--lens-views", "0") == 0
    exact, coarse = (read_exr(folder / "depth" / "view_000.exr") for folder in (made, tmp_path / "coarse"))
    error = np.abs(coarse / exact - 1)
    assert 0.3 * 2.0**-9 < error.max() <= 2.0**-9


@pytest.mark.slow
def test_a_killed_run_goes_on(made, tmp_path, repository):
    """SIGTERM ends with one line, SIGKILL with none; what is there at the end is the same."""
    command = dofbench("make-scene", "corridor", "--out", tmp_path / "s", *SMALL.split())
    path = {"PYTHONPATH": str(repository)}
    for number, image in ((signal.SIGTERM, "images/view_000.png"), (signal.SIGKILL, "lens/view_000_a1_f0.2.exr")):
        done = killed(command, (tmp_path / "s" / image).is_file, number=number, environment=path)
        if number == signal.SIGTERM and done.returncode:
            assert done.returncode == 128 + signal.SIGTERM and "rerun the same command to resume" in done.stdout
    assert call(tmp_path / "s") == 0
    assert (tmp_path / "s" / "SHA256SUMS").read_text() == (made / "SHA256SUMS").read_text()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ("beach", "recipe"),
        ("fence --views 1", "--views"),
        ("fence --focus 2", "--focus"),
        ("fence --aperture 0", "--aperture"),
        ("fence --aperture 1,1", "--aperture"),
        ("fence --focus a", "--focus"),
        ("fence --lens-views 30", "--lens-views"),
        ("fence --depth-bits 24", "--depth-bits"),
        ("fence --samples 1", "--samples"),
    ],
)
def test_a_wrong_option_is_one_line(arguments, named, capsys):
    assert app.main(["make-scene", *arguments.split()]) == 2
    assert re.fullmatch(rf"dofbench: {named}.*: found .+, expected .+\n", capsys.readouterr().err)


def test_other_settings_and_other_files_are_refused(made, tmp_path, capsys):
    assert call(made, "--seed", "1") == 2
    assert "made otherwise" in capsys.readouterr().err
    (tmp_path / "letter.txt").write_text("mine")
    assert call(tmp_path) == 2
    assert "no rendered scene" in capsys.readouterr().err
    (tmp_path / "scene.json").write_text('{"schema": "another"}')
    assert call(tmp_path) == 2
    assert "another kind of JSON" in capsys.readouterr().err


def test_all_goes_into_a_folder_each():
    parse: Callable = app.parse
    settings = parse(["make-scene", "all", "--out", "rendered"])
    assert [settings.folder(name) for name in settings.recipes][1] == Path("rendered/fence")
    assert parse(["make-scene", "fence"]).folder("fence") == Path("data/scenes/fence")
    assert len(settings.recipes) == 9
