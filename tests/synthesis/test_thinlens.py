"""--renderer thinlens: photographs through a real lens of a scene whose geometry is built again."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from made_up import cloud
from relisted import write_again
from tolerances import FLOAT32_VALUE, LEVEL_8BIT, SCATTER_OF_A_LENS

from dofbench.core.errors import InputError
from dofbench.core.files import sha256_file
from dofbench.core.images import read_exr, read_image, write_png
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import Dataset, check_dataset, make_dataset, method_points
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.photographing import Optics
from dofbench.optics.tone import encode
from dofbench.scenes.procedural import make_scene
from dofbench.scenes.procedural.scene_options import MakeScene

pytest.importorskip("mitsuba", reason="mitsuba is not installed (extra: render)")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small scene of make-scene's, without photographs through lenses."""
    out = tmp_path_factory.mktemp("rendered") / "corridor"
    settings = MakeScene("corridor", out=out, views=3, width=96, height=72, samples=128, lens_views=0)
    return make_scene(settings, progress=Silent())[0]


def made(scene: Path, out: Path, **options) -> Path:
    """A dataset of the scene, one lens with the near end in focus unless told."""
    asked = {"focus": (1.0,), "aperture": (1.0,), "renderer": "thinlens", "lens_samples": 128, **options}
    return make_dataset(MakeDataset(scene=str(scene), out=out, **asked), progress=Silent())


@pytest.fixture(scope="module")
def dataset(rendered: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its dataset. Nobody writes to it."""
    return made(rendered, tmp_path_factory.mktemp("datasets") / "thin")


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    """Of encoded images, dB."""
    return float(-10 * np.log10(np.mean((np.clip(one, 0, 1) - np.clip(other, 0, 1)) ** 2)))


@pytest.mark.slow
def test_photographs_say_what_they_are(dataset: Path) -> None:
    lenses = json.loads((dataset / "lens.json").read_text())
    assert lenses["renderer"] == "thinlens"
    assert {key: lenses["thinlens"][key] for key in ("recipe", "seed", "samples")} == {
        "recipe": "corridor",
        "seed": 0,
        "samples": 128,
    }
    for record in lenses["views"]:
        assert 0 < record["noise_rms_linear"] < 0.1 and record["noise_psnr_db"] > 30
        linear = read_exr(dataset / "images_linear" / f"{record['name']}.exr")
        encoded = read_image(dataset / "images" / f"{record['name']}.png")
        assert psnr(encode(linear), encoded) > 50
    text = (dataset / "README.md").read_text()
    assert "rendered through a thin lens" in text and "to within the rounding" not in text
    assert "--renderer thinlens --lens-samples 128" in text


def test_the_lens_is_the_one_of_the_scatter(rendered: Path, dataset: Path, tmp_path: Path) -> None:
    """Both blur the same scene by the same lens: nearer to each other than either is to the sharp image."""
    scattered = made(rendered, tmp_path / "scatter", renderer="scatter")
    for name in ("view_000", "view_001", "view_002"):
        real, near, sharp = (
            read_image(path / f"{name}.png")
            for path in (dataset / "images", scattered / "images", dataset / "all_in_focus")
        )
        assert psnr(real, near) > SCATTER_OF_A_LENS
        assert psnr(real, near) > psnr(real, sharp) + 3


@pytest.mark.slow
def test_what_is_lost_is_made_again(dataset: Path, tmp_path: Path, rendered: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    (copy / "images" / "view_001.png").unlink()
    made(rendered, copy)
    # The tracer's last bit isn't always the same, and may be what decides between two levels.
    again, before = (read_image(folder / "images" / "view_001.png") for folder in (copy, dataset))
    assert np.abs(again - before).max() <= LEVEL_8BIT * (1 + FLOAT32_VALUE)
    assert (copy / "lens.json").read_bytes() == (dataset / "lens.json").read_bytes()
    assert check_dataset(copy) == []


@pytest.fixture
def forged(dataset: Path, tmp_path: Path) -> Path:
    """A copy whose most blurred photograph is the sharp one, with every checksum brought up to date."""
    copy = shutil.copytree(dataset, tmp_path / "forged")
    views = json.loads((copy / "lens.json").read_text())["views"]
    name = max(views, key=lambda view: view["max_coc_px"])["name"]
    write_png(copy / f"images/{name}.png", read_image(copy / f"all_in_focus/{name}.png"))
    manifest = json.loads((copy / "dataset.json").read_text())
    for file, record in manifest["files"].items():
        record.update(sha256=sha256_file(copy / file), size=(copy / file).stat().st_size)
    write_again(copy / "dataset.json", manifest)
    return copy


@pytest.mark.slow
@pytest.mark.parametrize("with_mitsuba", [True, False])
def test_check_sees_an_image_that_is_not_the_lenss(
    with_mitsuba: bool, dataset: Path, forged: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not with_mitsuba:
        monkeypatch.setitem(sys.modules, "mitsuba", None)
    assert check_dataset(dataset) == []
    (problem,) = check_dataset(forged)
    assert problem.startswith("images/view_") and "dB" in problem
    assert ("compared with the scatter alone" in capsys.readouterr().err) is not with_mitsuba


@pytest.mark.slow
def test_a_closed_aperture_and_a_noisy_sensor(rendered: Path, tmp_path: Path) -> None:
    closed = made(rendered, tmp_path / "closed", aperture=(0.0,), lens_samples=8)
    assert (closed / "images/view_001.png").read_bytes() == (closed / "all_in_focus/view_001.png").read_bytes()
    assert "noise_rms_linear" not in json.loads((closed / "lens.json").read_text())["views"][0]
    assert check_dataset(made(rendered, tmp_path / "noisy", photons=500.0, lens_samples=32)) == []


def test_points_change_no_photograph(
    rendered: Path, dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, contents: Callable
) -> None:
    """Photographs and their noise are taken over, not rendered again; two training views have no points of their own,
    so these are made up."""
    camera = Dataset.load(dataset).training_views()[0].camera
    in_front = np.column_stack([np.random.default_rng(0).uniform(-0.2, 0.2, (100, 2)), np.full((100, 2), (9.0, 1.0))])
    points = cloud((in_front @ camera.camera_to_world.T)[:, :3], [np.array([0, 1])] * 100)
    monkeypatch.setattr(method_points, "triangulated_points", lambda *_, **__: points)
    monkeypatch.setattr(Optics, "photograph", lambda *_, **__: pytest.fail("rendered again"))
    found = contents(made(rendered, tmp_path / "out", points="shallow", reuse=dataset))
    before = contents(dataset)
    assert {name for name in before if before[name] != found.get(name)} == {
        "README.md",
        "dataset.json",
        "poses_bounds.npy",
        "sparse/0/images.bin",
        "sparse/0/points3D.bin",
    }
    record = json.loads(found["dataset.json"])["points"]
    assert (record["origin"], record["poses"], record["given"]) == ("triangulation", "exact", 100)
    usual = json.loads(before["dataset.json"])["points"]
    assert (usual["origin"], usual["poses"], usual["photographs"]) == ("rendered scene", "exact", "sharp")


def test_wrong_input(rendered: Path, scene: Path, tmp_path: Path) -> None:
    refused: list[tuple[Callable[[], object], str]] = [
        (lambda: made(scene, tmp_path / "a"), "no geometry"),
        (lambda: made(rendered, tmp_path / "b", width=90), "square pixels"),
        (lambda: made(rendered, tmp_path / "c", shape="6-gon"), "6-gon"),
        (lambda: made(rendered, tmp_path / "d", gamma=2.0), "2.2"),
        (lambda: made(rendered, tmp_path / "e", lens_samples=1), "--lens-samples"),
    ]
    for call, word in refused:
        with pytest.raises(InputError, match=word):
            call()
