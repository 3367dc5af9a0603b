"""The viewer's pictures: what each choice shows, and where a click focuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_scene import CAMERA, Known
from random_gaussians import scene
from tolerances import LEVEL_8BIT

from dofbench.core.cameras import NO_OFFSET
from dofbench.core.errors import InputError
from dofbench.core.images import to_8bit
from dofbench.core.jobs import Outcome
from dofbench.core.lens import ApertureShape, DisparityRange, PhysicalLens
from dofbench.evaluation.scoring.error_maps import error_map
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.splats import write_splats
from dofbench.viewing.camera_paths import dolly
from dofbench.viewing.picture import Look, at_photograph, fitting, picture
from dofbench.viewing.subject import Photograph, Subject, open_subject, open_subjects

METHOD = Known()
PHOTOGRAPHED = np.clip(METHOD.render(CAMERA, None).image + 0.05, 0, 1)
SUBJECT = Subject(
    name="known",
    scene="",
    photographs=(Photograph("one", "test", CAMERA, lambda: PHOTOGRAPHED),),
    up=np.array([0.0, -1.0, 0.0]),
    bounds=DisparityRange(0.2, 0.8),
    opening=7.0 / CAMERA.fx,
    render=lambda camera, lens, shape: METHOD.render(camera, lens),
)
PATCH = 3 * 0.6 / CAMERA.width  # change of disparity over three columns
LENS = PhysicalLens(7.0, 0.35, CAMERA.width)
LOOK = Look(half_opening=7.0 / CAMERA.fx, focus_disparity=0.35)


def shown(look: Look, camera=CAMERA) -> np.ndarray:
    return picture([SUBJECT], camera, look).pixels


def test_layers_show_what_they_are_called() -> None:
    sharp, blurred = METHOD.render(CAMERA, None), METHOD.render(CAMERA, LENS)
    assert np.array_equal(shown(LOOK), to_8bit(np.clip(blurred.image, 0, 1)))
    assert np.array_equal(shown(replace(LOOK, layer="all in focus")), to_8bit(np.clip(sharp.image, 0, 1)))
    assert np.array_equal(shown(replace(LOOK, half_opening=0.0)), shown(replace(LOOK, layer="all in focus")))
    near = shown(replace(LOOK, layer="depth")).astype(float)
    assert near[:, -4:, 1].mean() > near[:, :4, 1].mean() + 100, "near is bright"
    circles = shown(replace(LOOK, layer="circle of confusion")).astype(float).sum(axis=(0, 2))
    in_focus = int(np.argmin(circles))
    assert 0.2 + 0.6 * in_focus / CAMERA.width == pytest.approx(0.35, abs=PATCH), "dark where it is sharp"


def test_a_photograph_is_compared_at_its_own_camera_alone() -> None:
    assert np.array_equal(shown(replace(LOOK, layer="photograph")), to_8bit(PHOTOGRAPHED))
    rendered = np.clip(METHOD.render(CAMERA, LENS).image, 0, 1)
    assert np.array_equal(shown(replace(LOOK, layer="error")), error_map(rendered, PHOTOGRAPHED))
    wiped = shown(replace(LOOK, wipe=0.5))
    half = CAMERA.width // 2
    assert np.array_equal(wiped[:, : half - 1], to_8bit(PHOTOGRAPHED)[:, : half - 1])
    assert np.array_equal(wiped[:, half:], shown(LOOK)[:, half:])
    error = shown(replace(LOOK, layer="all in focus", left="error", wipe=0.5))
    assert np.array_equal(error[:, : half - 1], shown(replace(LOOK, layer="error"))[:, : half - 1])
    assert np.array_equal(error[:, half:], shown(replace(LOOK, layer="all in focus"))[:, half:])
    moved = dolly(CAMERA, 0.1)(1.0)
    depth = shown(replace(LOOK, left="depth", wipe=0.5), moved)
    assert np.array_equal(depth[:, : half - 1], shown(replace(LOOK, layer="depth"), moved)[:, : half - 1])
    assert np.array_equal(shown(replace(LOOK, wipe=0.5), moved), shown(LOOK, moved))
    assert at_photograph(SUBJECT, moved) is None and at_photograph(SUBJECT, CAMERA) is SUBJECT.photographs[0]
    assert np.array_equal(shown(replace(LOOK, layer="photograph"), moved), shown(LOOK, moved))


def test_a_photograph_is_placed_by_its_camera() -> None:
    """A window of twice the size shows the photograph twice as large."""
    twice = CAMERA.resized(2 * CAMERA.width, 2 * CAMERA.height)
    found = shown(replace(LOOK, layer="photograph"), twice).reshape(CAMERA.height, 2, CAMERA.width, 2, 3)
    assert np.abs(found.mean(axis=(1, 3)) - to_8bit(PHOTOGRAPHED))[2:-2, 2:-2].mean() < 6
    view = fitting(CAMERA, 2 * CAMERA.width, CAMERA.height)
    assert np.tan(view / 2) == pytest.approx(0.5 * CAMERA.height / CAMERA.fy), (
        "a wide window is filled from top to bottom"
    )
    view = fitting(CAMERA, CAMERA.width, 4 * CAMERA.height)
    assert np.tan(view / 2) == pytest.approx(2 * CAMERA.height / CAMERA.fy * 0.5 * 2), "a tall one from side to side"


def test_exposure_is_in_stops_of_light() -> None:
    one = shown(replace(LOOK, exposure=-1.0)).astype(float) / 255
    # Half a level of one picture and half of that of the other, in linear light, whose slope is at most 2.2.
    assert np.abs(one**2.2 - (shown(LOOK) / 255) ** 2.2 / 2).max() < 2.2 * 0.75 * LEVEL_8BIT


def test_subjects_stand_side_by_side() -> None:
    dark = replace(
        SUBJECT,
        render=lambda camera, lens, shape: replace(
            METHOD.render(camera, lens), image=np.zeros((camera.height, camera.width, 3), np.float32)
        ),
    )
    both = picture([SUBJECT, dark], CAMERA, LOOK)
    half = CAMERA.width // 2
    assert both.pixels.shape == (CAMERA.height, CAMERA.width, 3)
    assert both.pixels[:, :half].mean() > 50 and both.pixels[:, half + 1 :].max() == 0
    alone = picture([SUBJECT], both.cameras[0], LOOK).pixels
    assert np.array_equal(both.pixels[:, :half], alone), "each shows its middle, at the same scale"


def test_a_click_finds_the_disparity_there() -> None:
    one = picture([SUBJECT], CAMERA, LOOK)
    for across in (0.1, 0.5, 0.9):
        assert one.disparity_at(across, 0.5) == pytest.approx(0.2 + 0.6 * across, abs=PATCH)
    two = picture([SUBJECT, SUBJECT], CAMERA, LOOK)
    assert two.disparity_at(0.25, 0.5) == pytest.approx(two.disparity_at(0.75, 0.5))


def test_a_draft_is_the_scatter_renderer_with_the_shape_asked_for() -> None:
    hexagon = replace(LOOK, shape=ApertureShape(6))
    draft = picture([SUBJECT], CAMERA, hexagon, draft=True).pixels
    assert not np.array_equal(draft, picture([SUBJECT], CAMERA, LOOK, draft=True).pixels)
    assert np.abs(draft.astype(float) - shown(LOOK)).mean() < 6


def test_runs_datasets_and_gaussians_are_opened(call: Callable[..., Outcome], tmp_path: Path) -> None:
    end = call()
    run = open_subject(end.folder)
    assert run.name == "fake, quick" and run.render is not None and run.photographs[0].split == "test"
    assert run.opening == pytest.approx(5.0 / 200.0), "the fake's learned lens"
    data = open_subject(tmp_path / "data")
    assert data.render is None and data.scene == run.scene and len(data.photographs) == len(run.photographs)
    camera = data.photographs[0].camera
    found = picture([data], camera, LOOK).pixels
    assert np.array_equal(found, to_8bit(data.photographs[0].read()))
    assert picture([data], dolly(camera, 1.0)(1.0), LOOK).pixels.max() == 0
    with pytest.raises(InputError, match="a dataset besides others"):
        open_subjects([tmp_path / "data", end.folder])
    with pytest.raises(InputError, match="no such file or folder"):
        open_subject(tmp_path / "nothing")
    with pytest.raises(InputError, match="none of these"):
        open_subject(tmp_path)


def test_gaussians_of_any_program_are_shown(tmp_path: Path) -> None:
    write_splats(tmp_path / "scene.ply", Gaussians(scene(60, seed=3), None), NO_OFFSET)
    subject = open_subject(tmp_path / "scene.ply")
    camera = subject.photographs[0].camera.resized(96, 64)
    focused = Look(half_opening=subject.opening, focus_disparity=subject.bounds.q_max)
    sharp = picture([subject], camera, replace(focused, half_opening=0.0)).pixels
    assert sharp.std() > 5, "they are in front of the camera"
    assert picture([subject], camera, focused).pixels.std() < sharp.std()
