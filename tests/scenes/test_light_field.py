"""Light fields: what a folder must hold, the cameras of its views, and the weights of a window."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import light_field_scene as truth
import numpy as np
import pytest
from tolerances import CALIBRATED_PLACE, FLOAT64_VALUE, LANCZOS_OF_VIEWS_DB, SWEPT_DISPARITY

from dofbench.core.errors import InputError
from dofbench.core.images import read_image, write_png
from dofbench.core.similarity import psnr
from dofbench.scenes import load_scene
from dofbench.scenes.light_field.average import averaged
from dofbench.scenes.light_field.grid import read_grid
from dofbench.scenes.light_field.rig import NEAR_FAR, Rig
from dofbench.scenes.light_field.window import weights
from dofbench.scenes.listing import list_scenes


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field with positions, rows running up. Nobody writes to it."""
    return truth.write_light_field(tmp_path_factory.mktemp("light_fields") / "planes")


@pytest.fixture(scope="module")
def rig(folder: Path) -> Rig:
    """Its cameras."""
    return Rig.of(read_grid(folder))


def test_cameras_are_where_they_were(rig: Rig) -> None:
    found = {place: rig.camera(place, truth.WIDTH).centre for place in rig.grid.files}
    for place, (right, down) in truth.camera_offsets().items():
        assert found[place] == pytest.approx([right, down, 0.0], abs=CALIBRATED_PLACE)
    assert rig.calibration.epipolar_px < 0.1 and rig.calibration.matches > 1000


def test_cameras_see_every_plane_where_the_views_do(rig: Rig) -> None:
    """Whatever the focal length and the parallax of infinity are by convention, at any width."""
    x, y, width = 100.0, 40.0, truth.WIDTH // 2
    for parallax in (truth.FAR, truth.MIDDLE, truth.NEAR):
        z = rig.focal / (parallax / truth.STEP - rig.infinity)
        centre = rig.camera((0, 0), truth.WIDTH)
        point = np.array([[*(ray * z for ray in centre.rays(x, y)), z]])
        for place, offset in truth.camera_offsets().items():
            (at,), _ = rig.camera(place, width).project(point)
            expected = (np.array([x, y]) - parallax / truth.STEP * offset) / 2
            assert at == pytest.approx(expected, abs=CALIBRATED_PLACE * truth.NEAR / truth.STEP)


def test_what_is_free_is_by_convention(rig: Rig) -> None:
    low, high = rig.parallax
    assert (low, high) == pytest.approx((truth.FAR / truth.STEP, truth.NEAR / truth.STEP), abs=SWEPT_DISPARITY)
    assert rig.registered
    near, far = rig.depth(np.array([[high, low]]))[0]
    assert far / near == pytest.approx(NEAR_FAR)
    assert rig.disparity_range.q_min == pytest.approx(1 / far) and rig.disparity_range.q_max == pytest.approx(1 / near)


def test_rows_may_run_down(tmp_path: Path) -> None:
    turn = truth.Turn(angle=-0.02, rows_up=False)
    rig = Rig.of(read_grid(truth.write_light_field(tmp_path / "field", turn)))
    for place, (right, down) in truth.camera_offsets(turn).items():
        centre = rig.camera(place, truth.WIDTH).centre
        assert centre == pytest.approx([right, down, 0.0], abs=CALIBRATED_PLACE)


def test_cameras_with_fixed_principal_points(tmp_path: Path) -> None:
    """All points move one way; positions are steps where grid.json has none."""
    common = 0.7
    rig = Rig.of(read_grid(truth.write_light_field(tmp_path / "field", positions=False, common=common)))
    assert not rig.registered and rig.infinity == 0 and rig.grid.unit == "grid step"
    camera = rig.camera((1, 2), truth.WIDTH)
    assert (camera.cx, camera.cy) == (truth.WIDTH / 2, truth.HEIGHT / 2)
    assert camera.centre == pytest.approx([2.0, -1.0, 0.0], abs=CALIBRATED_PLACE)
    depth = rig.depth(rig.swept((0, 0), truth.WIDTH).disparity)
    expected = truth.parallax(*truth.pixels()) + common
    assert np.median(np.abs(rig.focal / depth - expected)) < SWEPT_DISPARITY


def test_any_view_is_swept(rig: Rig) -> None:
    """A view at the border has neighbours on two sides alone. Planes lie apart from where the centre view has them."""
    place = (-4, 4)
    found = rig.swept(place, truth.WIDTH)
    for plane, at in ((truth.FAR, (15, 140)), (truth.MIDDLE, (50, 50)), (truth.NEAR, (75, 110))):
        right, down = truth.camera_offsets()[place] * plane / truth.STEP
        row, column = round(at[0] - down), round(at[1] - right)
        assert found.disparity[row, column] * truth.STEP == pytest.approx(plane, abs=3 * SWEPT_DISPARITY)
    assert found.confidence.min() >= 0 and found.confidence.max() == 1
    assert np.mean(found.confidence) > 0.5


@pytest.mark.parametrize("radius", [7.0, 9.3, 14.0, 20.0])
@pytest.mark.parametrize("excluded", [(), ((1, 0), (-1, 2))])
def test_a_window_has_the_moments_of_a_disc(radius: float, excluded: tuple) -> None:
    random = np.random.default_rng(0)
    around = [(row, column) for row in range(-4, 5) for column in range(-4, 5)]
    positions = {place: truth.STEP * (np.array(place) + random.uniform(-0.1, 0.1, 2)) for place in around}
    positions[0, 0] = np.zeros(2)
    found = weights(radius, truth.STEP, positions, excluded)
    assert found is not None
    assert not set(found) & set(excluded) and min(found.values()) > 0
    u, w = np.array([positions[place] for place in found]), np.array(list(found.values()))
    assert w.sum() == pytest.approx(1, abs=FLOAT64_VALUE) and w @ u == pytest.approx([0, 0], abs=radius * FLOAT64_VALUE)
    assert (u.T * w) @ u == pytest.approx(radius**2 / 4 * np.eye(2), abs=radius**2 * FLOAT64_VALUE)
    # It is filled, no ring: views count less towards its rim, none in the middle much less.
    assert max(found.values()) < 2 * found[0, 0]


def test_a_window_that_is_too_small_has_no_weights() -> None:
    positions = {(row, column): np.array([row, column], float) for row in (-1, 0, 1) for column in (-1, 0, 1)}
    assert weights(0.4, 1.0, positions) is None
    assert weights(1.2, 1.0, positions, excluded=[(0, 1), (1, 1), (-1, 1)]) is None  # its centre is off


def test_the_average_is_the_direct_one(rig: Rig) -> None:
    """Of the same cameras, computed from the planes without any image that is shifted."""
    focus = 0.2
    places, margin = [(row, column) for row in (-2, 0, 3) for column in (-3, 1, 2)], 6
    share = np.arange(1.0, 10.0)
    views = (
        (rig.grid.read(place), tuple(focus / truth.STEP * by for by in rig.motion((0, 0), place, truth.WIDTH)), weight)
        for place, weight in zip(places, share, strict=True)
    )
    x, y = truth.pixels(margin=margin)
    offsets = truth.camera_offsets()
    light = [truth.seen(offsets[place], *_shifted(x, y, focus, offsets[place])) for place in places]
    expected = truth.encoded(np.tensordot(share / share.sum(), np.array(light), 1))
    found = truth.encoded(averaged(views)[margin:-margin, margin:-margin])
    assert psnr(found, expected) > LANCZOS_OF_VIEWS_DB
    # A step in the wrong direction, or equal weights, is another picture.
    assert psnr(truth.encoded(np.mean(light, axis=0)), expected) < LANCZOS_OF_VIEWS_DB - 6


def _shifted(x: np.ndarray, y: np.ndarray, focus: float, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return x - focus / truth.STEP * offset[0], y - focus / truth.STEP * offset[1]


def _edit_grid(folder: Path, **entries: object) -> None:
    path = folder / "grid.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))


def _without_position(folder: Path) -> None:
    positions = json.loads((folder / "grid.json").read_text())["position_vu_mm"]
    del positions["02_03"]
    _edit_grid(folder, position_vu_mm=positions)


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda path: (path / "grid.json").unlink(), "no grid.json"),
        (lambda path: (path / "grid.json").write_text("{"), "grid.json"),
        (lambda path: (path / "grid.json").write_text("[]"), "no centre"),
        (lambda path: _edit_grid(path, centre="middle"), "no centre"),
        (lambda path: _edit_grid(path, centre="20_20"), "no view 20_20"),
        (lambda path: (path / "views" / "03_04.png").unlink(), "gaps"),
        (lambda path: (path / "views" / "03_04.png").write_bytes(b"no image"), "03_04"),
        (lambda path: write_png(path / "views" / "03_04.png", np.zeros((9, 9, 3), np.float32)), "2 sizes"),
        (_without_position, "no position of view 02_03"),
        (lambda path: _edit_grid(path, position_vu_mm={f"{r:02d}_{c:02d}": [r, 0] for r in range(9) for c in range(9)}),
         "on a line"),
        (lambda path: _edit_grid(path, disparity_px_per_view_step={"horizontal": "wide"}), "no disparities"),
    ],
)  # fmt: skip
def test_a_folder_that_is_no_light_field(folder: Path, tmp_path: Path, damage, word: str) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    damage(copy)
    with pytest.raises(InputError, match=word) as caught:
        read_grid(copy)
    assert "\n" not in str(caught.value)


def test_views_of_a_camera_that_turned(folder: Path, tmp_path: Path) -> None:
    copy, random = shutil.copytree(folder, tmp_path / "copy"), np.random.default_rng(0)
    for file in sorted((copy / "views").glob("*.png")):
        write_png(file, np.roll(read_image(file), random.integers(-5, 6, 2), axis=(0, 1)))
    with pytest.raises(InputError, match="off their epipolar lines"):
        Rig.of(read_grid(copy))


def test_views_without_texture(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    for file in (copy / "views").glob("*.png"):
        write_png(file, np.full((truth.HEIGHT, truth.WIDTH, 3), 0.5, np.float32))
    with pytest.raises(InputError, match="0 features"):
        Rig.of(read_grid(copy))


def test_a_light_field_is_listed_and_is_no_scene_with_poses(folder: Path) -> None:
    (listed,) = [scene for scene in list_scenes([folder]) if scene.name == str(folder)]
    assert (listed.layout, listed.training, listed.width, listed.problem) == ("lightfield", 81, truth.WIDTH, "")
    with pytest.raises(InputError, match="--photographs light-field"):
        load_scene(folder)
