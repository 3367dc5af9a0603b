"""Facts measured on photographs: how blurred they are, and whether colours depend on the viewing direction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import cloud, frontal
from scipy.ndimage import gaussian_filter
from tolerances import DIFFERENCE_BLUR, EDGE_BLUR, GAIN_BY_MEDIANS, MEASURED_NOISE

from dofbench.core.content import content_folder
from dofbench.core.contracts import PointCloud, TrainingSet, TrainingView
from dofbench.core.image_files.exif import Exif
from dofbench.core.images import from_8bit, resize, to_8bit
from dofbench.core.lens import DisparityRange, Lens
from dofbench.methods.stages.colour_spread import colour_spread, light_spread, view_gains
from dofbench.methods.stages.facts import Facts, facts_of
from dofbench.methods.stages.stage_deciders import NEEDLESS_BLUR, NEEDLESS_COLOURS, NEEDLESS_DEPENDENCE
from dofbench.optics.blur_width import blur_deviation, noise_deviation
from dofbench.optics.defocus import defocus_numpy
from dofbench.running import kept_facts as kept_facts_module
from dofbench.running.kept_facts import kept_facts
from dofbench.scenes import load_scene

SMALLER = 2  # the built-in scene is looked at at half its size: seconds instead of half a minute
LENSES = tuple(Lens(aperture, focus) for aperture in (0.5, 1.0) for focus in (0.2, 0.5, 0.8))


@pytest.fixture(scope="module")
def sharp() -> tuple[TrainingSet, list[np.ndarray]]:
    """The built-in scene's photographs as they are, and the depth of each."""
    scene = load_scene(content_folder("datasets") / "tabletop")
    views, depths = [], []
    for view in scene.views[::2]:
        camera = view.camera.resized(view.camera.width // SMALLER, view.camera.height // SMALLER)
        image = from_8bit(to_8bit(resize(view.image(), camera.width, camera.height)))
        views.append(TrainingView(view.name, camera, image))
        depths.append(view.depth()[SMALLER // 2 :: SMALLER, SMALLER // 2 :: SMALLER][: camera.height, : camera.width])
    return TrainingSet(tuple(views), PointCloud(scene.points.xyz, scene.points.rgb, scene.points.error)), depths


def _through(sharp, lenses, noise: float = 0.0) -> TrainingSet:
    training_set, depths = sharp
    bounds = DisparityRange.of_disparity(np.concatenate([1 / depth[depth > 0] for depth in depths]))
    random, views = np.random.default_rng(0), []
    for number, (view, depth) in enumerate(zip(training_set.views, depths, strict=True)):
        image = defocus_numpy(view.image, depth, lenses[number % len(lenses)].physical(bounds, view.camera.width))[0]
        image = from_8bit(to_8bit(image + random.normal(0, noise, image.shape).astype(np.float32)))
        views.append(replace(view, image=image))
    return TrainingSet(tuple(views), training_set.points)


def test_photographs_in_focus_are_seen_to_be(sharp) -> None:
    assert facts_of(sharp[0], one_lens=False).blur_px < NEEDLESS_BLUR


@pytest.mark.parametrize("lenses", [LENSES, (Lens(1.0, 0.2),), (Lens(1.0, 0.8),)], ids=["several", "far", "near"])
def test_shallow_photographs_are_seen_to_be(sharp, lenses) -> None:
    assert facts_of(_through(sharp, lenses), one_lens=False).blur_px > NEEDLESS_BLUR


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_noise_doesn_t_pass_for_sharpness(sharp, noise: float) -> None:
    blur = facts_of(_through(sharp, LENSES, noise), one_lens=False).blur_px
    assert blur is None or blur > NEEDLESS_BLUR


@given(st.floats(0.6, 3.0), st.floats(0.2, 0.8), st.booleans())
def test_a_known_blur_of_an_edge_is_found(deviation: float, contrast: float, upright: bool) -> None:
    edge = np.zeros((48, 48))
    edge[:, 24:] = contrast
    image = gaussian_filter(edge if upright else edge.T, deviation)
    found = blur_deviation(image)[24, 24]
    assert deviation / EDGE_BLUR <= found <= np.hypot(deviation, DIFFERENCE_BLUR) * EDGE_BLUR


def test_nothing_to_judge_by_is_nothing_found() -> None:
    assert np.isnan(blur_deviation(np.full((32, 32), 0.5))).all()
    assert np.isnan(blur_deviation(np.random.default_rng(1).normal(0.5, 0.02, (64, 64)))).mean() > 0.9


@given(st.floats(0.002, 0.1))
def test_noise_is_measured(deviation: float) -> None:
    ramp = np.linspace(0, 1, 128)[None, :] * np.linspace(0, 1, 128)[:, None]
    found = noise_deviation(ramp + np.random.default_rng(0).normal(0, deviation, ramp.shape))
    assert found == pytest.approx(deviation, rel=MEASURED_NOISE)


def _plain(change: float) -> TrainingSet:
    """A wall with soft stains, seen by six cameras side by side; each sees it brighter by `change` of 255 at most."""
    random = np.random.default_rng(2)
    stains = gaussian_filter(random.normal(0, 1, (200, 400, 3)), (12, 12, 0))
    wall = 0.5 + 0.1 * stains / stains.std()
    points = np.stack([random.uniform(-1, 1, 800), random.uniform(-0.4, 0.4, 800), np.full(800, 2.0)], axis=1)
    views = []
    for number in range(6):
        camera = frontal(160, 120, 200.0, (-0.05 * number, 0.0, 0.0))  # 5 pixels at z 2
        image = wall[40:160, 120 - 5 * number : 280 - 5 * number] + change * number / 5 / 255
        views.append(TrainingView(f"v{number}", camera, from_8bit(to_8bit(image.astype(np.float32)))))
    return TrainingSet(tuple(views), cloud(points))


def test_a_wall_that_looks_alike_from_everywhere_is_seen_to() -> None:
    assert facts_of(_plain(0.0), one_lens=False).view_dependence < NEEDLESS_DEPENDENCE


def test_a_wall_that_changes_with_the_direction_is_seen_to() -> None:
    assert facts_of(_plain(20.0), one_lens=False).view_dependence > NEEDLESS_DEPENDENCE


def test_photographs_by_one_exposure_are_seen_as_such_and_one_by_another_is_not() -> None:
    assert facts_of(_plain(0.0), one_lens=False).colour_spread < NEEDLESS_COLOURS
    assert facts_of(_plain(60.0), one_lens=False).colour_spread > NEEDLESS_COLOURS


@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_factors_of_exposure_and_white_balance_are_found(outliers: float) -> None:
    random = np.random.default_rng(3)
    true = random.normal(0, 0.15, (7, 3))
    colours = np.exp(true)[:, None] * random.uniform(0.2, 0.6, (300, 3)) * (1 + random.normal(0, 0.01, (7, 300, 3)))
    wrong = random.uniform(size=(7, 300)) < outliers
    colours[wrong] = random.uniform(0.1, 0.9, (int(wrong.sum()), 3))
    colours[random.uniform(size=(7, 300)) < 0.4] = np.nan
    found = view_gains(colours)
    assert np.abs(found - (true - np.median(true, axis=0))).max() < GAIN_BY_MEDIANS
    assert colour_spread(colours) == pytest.approx(100 * true.std(axis=0).max(), abs=100 * GAIN_BY_MEDIANS)


def test_a_photograph_that_shares_too_little_says_nothing() -> None:
    colours = np.full((5, 100, 3), 0.5)
    colours[4, 10:] = np.nan
    assert np.isnan(view_gains(colours)[4]).all() and np.isfinite(view_gains(colours)[:4]).all()
    colours[1:, 10:] = np.nan
    assert np.isnan(view_gains(colours)).all() and colour_spread(colours) is None
    colours[:] = 1.0  # blown out
    assert colour_spread(colours) is None


def test_exif_tells_how_far_the_light_differs_only_when_it_tells_of_every_photograph() -> None:
    records = [Exif(f_number=8.0, exposure=0.01, iso=iso) for iso in (100, 400)]
    assert light_spread(records) == pytest.approx(1.0)
    assert light_spread([*records, Exif(f_number=8.0)]) is None
    assert light_spread([*records, None]) is None and light_spread([]) is None


def test_without_points_nothing_is_told() -> None:
    facts = facts_of(TrainingSet(_plain(0.0).views, None), one_lens=True)
    assert (facts.points, facts.blur_px, facts.view_dependence, facts.one_lens) == (0, None, None, True)


def test_points_that_nothing_sees_tell_nothing() -> None:
    behind = cloud(np.full((50, 3), -1.0))
    facts = facts_of(TrainingSet(_plain(0.0).views, behind), one_lens=False)
    assert (facts.points, facts.blur_px, facts.view_dependence) == (50, None, None)


def test_facts_are_found_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    looked = []

    def look() -> Facts:
        looked.append(1)
        return Facts(7, 0.1 + 0.2, None, True, 3.5)

    first = kept_facts("sum", "shallow", 0.0, look)
    assert kept_facts("sum", "shallow", 0.0, look) == first == Facts(7, 0.1 + 0.2, None, True, 3.5) and len(looked) == 1
    for other in (("other", "shallow", 0.0), ("sum", "all-in-focus", 0.0), ("sum", "shallow", 0.05)):
        kept_facts(*other, look)
    assert len(looked) == 4
    monkeypatch.setattr(kept_facts_module, "package_digest", lambda: "changed code")
    kept_facts("sum", "shallow", 0.0, look)
    assert len(looked) == 5


@pytest.mark.parametrize("damage", ["", "{", '{"points": 1, "no": 2}', "[]"])
def test_a_damaged_cache_is_an_empty_one(damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = Facts(7, None, None, None)
    kept_facts("sum", "shallow", 0.0, lambda: found)
    (file,) = (tmp_path / "dofbench" / "facts").iterdir()
    file.write_text(damage)
    assert kept_facts("sum", "shallow", 0.0, lambda: found) == found
