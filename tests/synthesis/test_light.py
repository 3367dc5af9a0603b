"""Scenes of linear light: what is brighter than white is blurred as bright as it is."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from relisted import write_again
from tolerances import FLOAT16_VALUE, FLOAT32_VALUE, LEVEL_8BIT, SCATTER_ENERGY

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr, read_image, write_exr
from dofbench.core.progress import Silent
from dofbench.datasets.format.dataset import Dataset
from dofbench.datasets.synthesis import check_dataset, make_dataset
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.scenes import load_scene

pytestmark = pytest.mark.usefixtures("one_torch_thread")
GREY, GLINT, ROW, COLUMN = 0.47, 60.0, 48, 100
GAMMA = 2.2


@pytest.fixture
def light_scene(scene, tmp_path) -> Path:
    """The tiny scene with images of linear light: grey, with one bright pixel on the far plane."""
    root = shutil.copytree(scene, tmp_path / "light")
    for index, file in enumerate(sorted((root / "images").iterdir())):
        height, width = read_image(file).shape[:2]
        light = np.full((height, width, 3), GREY, np.float32)
        light[ROW, COLUMN] = GLINT
        light[0, 0] = 0.1 * index  # no two views are the same photograph
        write_exr(file.with_suffix(".exr"), light)
        file.unlink()
    text = (root / "transforms.json").read_text()
    (root / "transforms.json").write_text(text.replace(".png", ".exr"))
    return root


def made(scene: Path, out: Path, **options) -> Path:
    return make_dataset(MakeDataset(scene=str(scene), out=out, **options), progress=Silent())


def test_a_scene_knows_its_light(light_scene):
    scene = load_scene(light_scene)
    view = scene.views[1]
    assert view.linear is not None and view.linear().max() == GLINT
    expected = np.full(view.image().shape, GREY ** (1 / GAMMA), np.float32)
    expected[ROW, COLUMN] = 1
    expected[0, 0] = 0.1 ** (1 / GAMMA)
    assert np.abs(view.image() - expected).max() <= FLOAT32_VALUE
    assert any("linear light" in note for note in scene.notes)


@pytest.mark.parametrize("stored", ["exr-half", "exr-float"])
def test_values_go_through_unchanged_but_for_the_blur(light_scene, tmp_path, capsys, stored):
    folder = made(light_scene, tmp_path / "out", linear=stored, focus=(1.0,), aperture=(1.0,))
    assert check_dataset(folder) == []
    dataset = Dataset.load(folder)
    view = dataset.training_views()[0]
    linear, light = dataset.linear(view), dataset.all_in_focus_linear(view)
    tolerance = GLINT * (FLOAT16_VALUE if stored == "exr-half" else FLOAT32_VALUE)
    assert light.max() == GLINT and np.abs(np.sort(np.unique(light[1:])) - [GREY, GLINT]).max() <= tolerance
    far = linear[:16, -40:]
    assert np.abs(far - GREY).max() <= FLOAT16_VALUE
    assert np.abs(dataset.image(view)[:16, -40:] - GREY ** (1 / GAMMA)).max() <= LEVEL_8BIT
    assert np.abs(dataset.all_in_focus(view)[0, 1] - GREY ** (1 / GAMMA)).max() <= LEVEL_8BIT / 2 + FLOAT32_VALUE
    # A disc of the radius that lens.json says, and all of the light of the point in it.
    radius = view.max_coc_px
    assert 2 < radius < 3
    rows, columns = np.mgrid[: linear.shape[0], : linear.shape[1]]
    distance = np.hypot(rows - ROW, columns - COLUMN)
    more = linear[..., 1] - GREY
    assert more[distance <= radius + 1.5].sum() == pytest.approx(GLINT - GREY, rel=5 * SCATTER_ENERGY)
    assert more[distance < radius - 1].min() > 0.5 * GLINT / (np.pi * radius**2) > 1
    assert np.abs(more[(distance > radius + 2) & (columns > 90)]).max() <= FLOAT16_VALUE
    manifest = json.loads((folder / "dataset.json").read_text())
    assert all(image["linear"] is True for image in manifest["source"]["images"])
    assert any("6 of 73728 pixels are brighter than 1" in note for note in manifest["source"]["notes"])
    assert "all_in_focus_linear" in (folder / "README.md").read_text()
    assert "pixels are brighter than 1" in capsys.readouterr().err


def test_what_was_cut_off_goes_on_with_the_same_bytes(light_scene, tmp_path, contents):
    folder = made(light_scene, tmp_path / "out")
    before = contents(folder)
    for name in ("all_in_focus_linear/v02.exr", "images/v02.png", "images_linear/v02.exr"):
        (folder / name).unlink()
    made(light_scene, folder)
    assert contents(folder) == before


def test_another_lens_takes_the_light_over(light_scene, tmp_path, monkeypatch):
    from dofbench.datasets.synthesis.builder import make

    first = made(light_scene, tmp_path / "one")
    monkeypatch.setattr("dofbench.datasets.synthesis.builder.light_of", None)
    settings = MakeDataset(scene=str(light_scene), out=tmp_path / "two", focus=(0.2,))
    second = make(settings, Silent(), sibling=first)
    assert check_dataset(second) == []
    # Another gamma encodes the light anew.
    with pytest.raises(TypeError):
        make(MakeDataset(scene=str(light_scene), out=tmp_path / "three", gamma=2.0), Silent(), sibling=first)


def test_check_blurs_the_light_again(light_scene, tmp_path):
    folder = made(light_scene, tmp_path / "out", focus=(1.0,), aperture=(1.0,))
    for file in (folder / "all_in_focus_linear").iterdir():
        write_exr(file, np.minimum(read_exr(file) * np.float32(1.2), 1), half=True)
    manifest = json.loads((folder / "dataset.json").read_text())
    for name, record in manifest["files"].items():
        record.update(sha256=sha256_file(folder / name), size=(folder / name).stat().st_size)
    write_again(folder / "dataset.json", manifest)
    assert any("from the blur computed again" in problem for problem in check_dataset(folder))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_light_that_is_not_finite_is_refused(light_scene, tmp_path, value):
    light = np.full((96, 128, 3), GREY, np.float32)
    light[3, 4, 1] = value
    write_exr(light_scene / "images" / "v01.exr", light)
    with pytest.raises(InputError, match=r"v01.exr.*not finite in 1 pixels"):
        made(light_scene, tmp_path / "out")


def test_a_negative_channel_counts_as_none(light_scene):
    light = np.full((96, 128, 3), (0.4, -0.1, 0.3), np.float32)  # a purple outside the gamut
    write_exr(light_scene / "images" / "v01.exr", light)
    read = load_scene(light_scene).views[1].linear()
    assert not read[..., 1].any() and (read[..., (0, 2)] > 0).all()


def test_light_that_no_colour_has_is_refused(light_scene):
    light = np.full((96, 128, 3), GREY, np.float32)
    light[3, 4] = -0.5
    write_exr(light_scene / "images" / "v01.exr", light)
    with pytest.raises(InputError, match=r"v01.exr.*negative luminance in 1 pixels"):
        load_scene(light_scene).views[1].linear()
