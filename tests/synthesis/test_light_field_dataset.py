"""--photographs light-field: averages of real views, their lenses, cameras and truth."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import light_field_scene as truth
import numpy as np
import pytest
from relisted import relist
from tolerances import (
    CALIBRATED_PLACE,
    DISC_OF_VIEWS_DB,
    SCATTER_OF_PLANES_DB,
    SCATTER_OF_REAL_VIEWS_DB,
    SWEPT_DISPARITY,
)

from dofbench.cli import app
from dofbench.core.blur import Blur
from dofbench.core.errors import InputError
from dofbench.core.images import read_exr, read_image
from dofbench.core.lens import COC_FRACTION, Lens, PhysicalLens
from dofbench.core.progress import Silent
from dofbench.datasets.synthesis import Dataset, check_dataset, make_dataset, method_points
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.light_field import LightField
from dofbench.datasets.synthesis.render_views import Photography, view_record
from dofbench.optics.defocus import defocus_numpy
from dofbench.scenes import load_scene
from dofbench.scenes.light_field.grid import Grid
from dofbench.scenes.named import resolve

PER_STEP = truth.NEAR - truth.FAR
ASKED = {"focus": (0.0, 0.6, 1.0), "aperture": (0.34, 0.68)}


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field of planes. Nobody writes to it."""
    return truth.write_light_field(tmp_path_factory.mktemp("light_fields") / "planes")


@pytest.fixture(scope="module")
def field(grid: Path) -> LightField:
    """Its views and photographs, by default settings."""
    return opened(grid)


@pytest.fixture(scope="module")
def dataset(grid: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Its dataset. Nobody writes to it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method_points, "LEAST_POINTS", 20)  # the views are small, and have some fifty points
        yield made(grid, tmp_path_factory.mktemp("datasets") / "planes")


def opened(grid: Path, **options) -> LightField:
    (found,) = resolve(str(grid), None)
    return LightField(found, MakeDataset(**{**ASKED, **options}))


def made(grid: Path, out: Path, **options) -> Path:
    asked = {**ASKED, "photographs": "light-field", "bits": 16, **options}
    return make_dataset(MakeDataset(scene=str(grid), out=out, **asked), progress=Silent())


def offset_of(name: str) -> np.ndarray:
    """(right, down) of the view's camera."""
    row, column = (int(number) - truth.STEPS for number in name.split("_"))
    return truth.camera_offsets()[row, column]


def from_disc(name: str, photograph: np.ndarray, aperture: float, focus: float, margin: int) -> float:
    """PSNR in dB of a part of a photograph, encoded, from its closed form by what A and F mean (docs/conventions.md).
    The part shows all planes and their outlines."""
    radius = COC_FRACTION * photograph.shape[1] * aperture / (PER_STEP / truth.STEP)
    x, y = (at[25:75, 30:120] for at in truth.pixels(margin=margin))
    light = truth.averaged_over_disc(offset_of(name), radius, truth.FAR + focus * PER_STEP, x, y)
    return decibels(photograph[25:75, 30:120], truth.encoded(light))


def decibels(one: np.ndarray, other: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


@pytest.mark.parametrize(("aperture", "focus"), [(0.68, 0.0), (0.68, 1.0), (0.34, 0.6)])
def test_a_photograph_is_by_the_lens_that_is_stated(field: LightField, aperture: float, focus: float) -> None:
    """Against a dense aperture in closed form. A lens that is off a little is farther from it."""
    view, margin = field.scene.views[5], field.record.margin_px
    photograph = truth.encoded(field.photograph(view.camera, recorded(field, 5, Lens(aperture, focus))))
    stated = from_disc(view.name, photograph, aperture, focus, margin)
    assert stated > DISC_OF_VIEWS_DB
    for scale, by in ((0.85, 0.0), (1.15, 0.0), (1.0, 0.07), (1.0, -0.07)):
        assert from_disc(view.name, photograph, scale * aperture, focus + by, margin) < stated - 1


@pytest.mark.parametrize("renderer", ["scatter", "layered"])
def test_a_method_s_model_with_the_truth_gives_the_photograph(field: LightField, renderer: str) -> None:
    """The untouched view, blurred by the stated lens in scene units and the planes' true depth; on the near plane,
    where circles have a radius of two pixels: smaller ones of the scatter are rounder than its pixels."""
    view, margin = field.scene.views[4], field.record.margin_px
    x, y = truth.pixels(margin=margin)
    units = (truth.parallax(x, y) / truth.STEP - field.record.infinity_px) / field.record.focal_px
    depth = (1 / units).astype(np.float32)
    inside = np.hypot(x - 112, y - 70) < 24
    record = recorded(field, 4, Lens(0.68, 0.0))
    photograph = truth.encoded(field.photograph(view.camera, record))

    def modelled(scale: float) -> float:
        lens = record.physical(view.camera.width)
        lens = PhysicalLens(scale * lens.aperture, lens.focus_disparity, lens.width)
        blurred, _ = defocus_numpy(view.image(), depth, lens, Blur(renderer=renderer))
        return decibels(blurred[inside], photograph[inside])

    assert modelled(1.0) > SCATTER_OF_PLANES_DB
    assert modelled(1.0) > max(modelled(0.8), modelled(1.25)) + 1


def recorded(field: LightField, index: int, lens: Lens):
    """The record of a view by this lens."""
    from dofbench.datasets.synthesis.lens_plan import PlannedView

    view = field.scene.views[index]
    depth = np.full((view.camera.height, view.camera.width), 1 / field.disparity_range.q_max, np.float32)
    return view_record(PlannedView(view.name, view.split, lens), depth, Photography(field.disparity_range, False))


def test_test_views_are_in_no_window_of_a_training_view(field: LightField, monkeypatch: pytest.MonkeyPatch) -> None:
    read, original = [], Grid.read
    monkeypatch.setattr(
        Grid, "read", lambda self, place, width=None: read.append(place) or original(self, place, width)
    )
    tests = {tuple(int(n) - truth.STEPS for n in view.name.split("_")) for view in field.scene.test_views()}
    assert len(tests) == 2 and len(field.scene.views) == 9
    for index, view in enumerate(field.scene.views):
        read.clear()
        field.photograph(view.camera, recorded(field, index, Lens(0.68, 0.5)))
        assert len(read) == len(set(read)) > 15
        assert not tests & set(read) or view.split == "test"
    assert tests & set(read)  # the last view is a test view, whose own photograph is of all views around it


def test_sharp_images_are_the_untouched_views(field: LightField, grid: Path) -> None:
    margin = field.record.margin_px
    assert 0 < margin < 8
    for view in field.scene.views:
        whole = read_image(grid / "views" / f"{view.name}.png")
        np.testing.assert_array_equal(view.image(), whole[margin:-margin, margin:-margin])


def test_a_smaller_size_has_the_lens_of_the_larger(grid: Path, field: LightField) -> None:
    half = opened(grid, width=72)
    assert half.disparity_range == field.disparity_range
    camera, whole = half.scene.views[0].camera, field.scene.views[0].camera
    assert (camera.width, half.scene.views[0].image().shape[1]) == (72, 72)
    assert camera.cx - 36 == pytest.approx((whole.cx - whole.width / 2) * camera.fx / whole.fx)
    light, other = (
        one.photograph(one.scene.views[5].camera, recorded(one, 5, Lens(0.68, 1.0))) for one in (half, field)
    )
    # In its window as in that of the whole size, the same share of the width is a circle of confusion.
    assert light.mean() == pytest.approx(other.mean(), rel=0.02)


@pytest.mark.slow
def test_the_dataset(dataset: Path) -> None:
    found = Dataset.load(dataset)
    assert check_dataset(dataset) == []
    assert (found.photographer, found.assign, found.role) == ("light-field", "per-view", None)
    assert not found.has_exact_depth and found.points_record.poses == "grid of a light field"
    assert found.points_record.photographs == "shallow" and found.points_record.views == "training"
    margin = found.lenses.light_field.margin_px
    for view in found.views:
        assert view.lens is not None and view.has_all_in_focus and view.has_depth
        assert from_disc(view.name, found.image(view), view.lens.aperture, view.lens.focus, margin) > DISC_OF_VIEWS_DB
        assert decibels(truth.encoded(read_exr(dataset / "images_linear" / f"{view.name}.exr")), found.image(view)) > 60
    assert {view.lens.focus for view in found.views} == {0.0, 0.6, 1.0}
    text = (dataset / "README.md").read_text()
    assert "average of real views" in text and "to within the rounding" not in text
    assert "--photographs light-field" in text and "--aperture 0.34,0.68" in text


@pytest.mark.slow
def test_cameras_in_every_file_have_their_principal_points(dataset: Path) -> None:
    found, by_colmap = Dataset.load(dataset), load_scene(dataset, layout="colmap", hold=2)
    record, focal = found.lenses.light_field, found.views[0].camera.fx
    middle = found.view(f"{truth.STEPS:02d}_{truth.STEPS:02d}").camera
    for view, other in zip(found.views, by_colmap.views, strict=True):
        assert other.camera.parameters == pytest.approx(view.camera.parameters)
        for parallax in (truth.FAR, truth.NEAR):
            z = focal / (parallax / truth.STEP - record.infinity_px)
            (at,), _ = view.camera.project(np.array([[*(ray * z for ray in middle.rays(60.0, 50.0)), z]]))
            expected = np.array([60.0, 50.0]) - parallax / truth.STEP * offset_of(view.name)
            assert at == pytest.approx(expected, abs=CALIBRATED_PLACE)


@pytest.mark.slow
def test_depth_is_that_of_the_planes(dataset: Path) -> None:
    found = Dataset.load(dataset)
    view = found.view(f"{truth.STEPS:02d}_{truth.STEPS:02d}")
    record = found.lenses.light_field
    parallax = (record.focal_px / found.depth(view) + record.infinity_px) * truth.STEP
    error = np.abs(parallax - truth.parallax(*truth.pixels(margin=record.margin_px)))
    assert np.median(error) < SWEPT_DISPARITY and np.mean(error > 0.1) < 0.1
    assert np.median(found.confidence(view)) > 0.5
    given = found.training_points()
    near, far = (record.focal_px / (plane / truth.STEP - record.infinity_px) for plane in (truth.NEAR, truth.FAR))
    assert 0.9 * near < np.median(given.xyz[:, 2]) < 1.1 * far


@pytest.mark.slow
def test_a_changed_photograph_and_a_changed_lens_are_found(dataset: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    lenses = json.loads((copy / "lens.json").read_text())
    most = max(lenses["views"], key=lambda view: view["max_coc_px"])["name"]
    shutil.copyfile(copy / "all_in_focus" / f"{most}.png", copy / "images" / f"{most}.png")
    relist(copy)
    assert any("from the scatter" in problem for problem in check_dataset(copy))
    (copy / "lens.json").write_text(json.dumps(lenses | {"light_field": None}))
    relist(copy)
    assert any("light_field" in problem for problem in check_dataset(copy))


@pytest.mark.slow
def test_made_again(dataset: Path, grid: Path, tmp_path: Path, monkeypatch, contents: Callable, capsys) -> None:
    monkeypatch.setattr(method_points, "LEAST_POINTS", 20)
    asked = ["--like", str(dataset / "dataset.json"), "--out", str(tmp_path / "again")]
    assert app.main(["make-dataset", str(grid), *asked]) == 0
    assert "the same bytes" in capsys.readouterr().out
    assert contents(tmp_path / "again") == contents(dataset)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"renderer": "layered"}, "--renderer: found layered for planes, a light field"),
        ({"depth": "splat"}, "--depth: found splat"),
        ({"photons": 100.0}, "--photons"),
        ({"normaliser": "view"}, "--normaliser"),
        ({"train_f_number": 2.0, "test_f_number": 4.0}, "--train-f-number"),
        ({"images": "views"}, "--images"),
        ({"width": 161}, "--width: found 161, expected at most 160"),
        ({"width": 159}, "--width: found 159, expected at most 1[45]"),
        ({"aperture": (1.0,)}, r"--aperture: found 1, a window of 2\.\d+ grid steps in radius, expected at most 0\.8"),
        ({"aperture": (0.1,)}, r"--aperture of view 00_00: found a window of 0\.28 grid steps .* too few views"),
        ({"spacing": 4}, "--spacing: found 4, and 4 steps"),
        ({"hold": 2, "spacing": 1, "aperture": (0.4,)}, "whose views are test views"),
    ],
)
def test_what_does_not_apply_is_one_line(grid: Path, tmp_path: Path, options: dict, word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        made(grid, tmp_path / "out", **options)
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()


def test_other_scenes_have_no_windows(scene: Path, grid: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no grid.json"):
        made(scene, tmp_path / "out")
    with pytest.raises(InputError, match="--spacing: found planes, no light field"):
        make_dataset(MakeDataset(scene=str(scene), out=tmp_path / "out", spacing=3), progress=Silent())
    with pytest.raises(InputError, match="whose views have no poses"):
        make_dataset(MakeDataset(scene=str(grid), out=tmp_path / "out", photographs="shallow"), progress=Silent())
    small = truth.write_light_field(tmp_path / "small")
    for row in range(9):
        for column in range(9):
            if max(abs(row - 4), abs(column - 4)) > 1:
                (small / "views" / f"{row:02d}_{column:02d}.png").unlink()
    with pytest.raises(InputError, match="1 step from the centre"):
        made(small, tmp_path / "out")


def test_apertures_that_the_grid_holds_unless_asked(grid: Path) -> None:
    """Windows of a half and a quarter of the steps to the border, as --photographs auto takes a light field too."""
    settings = opened(grid, aperture=None).settings
    small, large = settings.aperture
    assert large == pytest.approx(2 * PER_STEP / (COC_FRACTION * truth.WIDTH), abs=0.02) and small == large / 2
    assert (settings.photographs, settings.spacing, settings.points) == ("light-field", 2, "shallow")
    assert opened(grid, aperture=None, spacing=3).settings.aperture[1] < large


@pytest.mark.slow
def test_a_real_light_field(real_data: Callable[[str], Path]) -> None:
    """Chess pieces: the scatter of an untouched view by the stated lens and the swept depth is the average of the real
    views, and no other lens gives it."""
    field = opened(real_data("lightfield_chess"), width=350, focus=(0.2, 0.5, 0.8), aperture=None)
    assert field.record.epipolar_px < 0.25 and field.record.registered
    view = next(view for view in field.scene.views if view.name == "08_08")
    depth = field.depth.estimate(view).depth
    index = field.scene.views.index(view)
    record = recorded(field, index, Lens(field.settings.aperture[1], 0.2))
    photograph = truth.encoded(field.photograph(view.camera, record))
    inside = np.s_[16:-16, 16:-16]

    def modelled(scale: float, focus: float) -> float:
        lens = Lens(scale * record.aperture, focus).physical(field.disparity_range, view.camera.width)
        blurred, _ = defocus_numpy(view.image(), depth, lens, Blur())
        return decibels(np.clip(blurred, 0, 1)[inside], photograph[inside])

    best = modelled(1.0, 0.2)
    assert best > SCATTER_OF_REAL_VIEWS_DB
    assert best > max(modelled(0.85, 0.2), modelled(1.15, 0.2), modelled(1.0, 0.13), modelled(1.0, 0.27))
