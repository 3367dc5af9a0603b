"""Radiance fields with lenses: they refocus, are stored and read, and learn a lens."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import Recorder
from small_scene import WIDTH, cameras, field_options, training_set
from tolerances import DISC_ON_FEWER_PIXELS, DISC_ON_PIXELS, FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.contracts import Rendering, Sketches
from dofbench.core.errors import InputError, Status
from dofbench.core.lens import PhysicalLens
from dofbench.methods.dofnerf.method import DoFNeRF
from dofbench.methods.lensnerf.method import LensNeRF
from dofbench.optics.defocus import defocus_numpy
from dofbench.training.fields import field_trainer
from dofbench.training.fields.cube_rays import RaysSeen
from dofbench.training.fields.lens_field import LensFieldMethod, through_points

SHORT = field_options()
METHODS = {"rays": (LensNeRF, {"lens_points": 5}), "patch": (DoFNeRF, {"patch_side": 20, "patch_from": 0.4})}


def trained(kind: str) -> tuple[LensFieldMethod, Recorder]:
    make, own = METHODS[kind]
    method, recorder = make({**SHORT, **own}, 0, "cpu"), Recorder()
    assert method.fit(training_set(), Budget(), recorder).status is Status.OK
    return method, recorder


@pytest.mark.slow
@pytest.mark.parametrize("kind", METHODS)
def test_it_learns_refocuses_and_is_read_again(kind: str, tmp_path: Path) -> None:
    method, recorder = trained(kind)
    assert np.mean(recorder.losses[-9:]) < 0.8 * np.mean(recorder.losses[:9])
    estimates = method.lens_estimates()
    assert estimates is not None and list(estimates) == ["v0", "v1", "v2"]
    first = METHODS[kind][0](SHORT, 0, "cpu")
    first.fit(training_set(), Budget(steps=1), Recorder())
    start = first.lens_estimates()
    assert start is not None and all(estimates[name] != start[name] for name in estimates)
    method.save(tmp_path)
    again = METHODS[kind][0]({}, 0, "cpu")
    again.load(tmp_path)
    assert again.lens_estimates() == estimates
    for lens in (None, PhysicalLens(20.0, 0.3, WIDTH)):
        one, other = (m.render(cameras()[0], lens) for m in (method, again))
        assert np.array_equal(one.image, other.image) and np.array_equal(one.depth, other.depth)
    sharp, closed, wide = (
        method.render(cameras()[0], lens).image
        for lens in (None, PhysicalLens(0.0, 0.3, WIDTH), PhysicalLens(40.0, 0.0, WIDTH))
    )
    np.testing.assert_allclose(closed, sharp, atol=FLOAT32_VALUE)
    assert np.abs(wide - sharp).mean() > 0.01


@pytest.mark.parametrize(
    ("kind", "expected"), [("rays", ["adam", "field", "tone"]), ("patch", ["adam", "field", "scatter", "tone"])]
)
def test_kernels_are_compiled_before_the_clock_starts(
    kind: str, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(field_trainer, "compile_all", lambda ops, device: asked.extend(ops))

    class Watching(Recorder):
        def after_step(self, step: int, loss: float) -> bool:
            assert asked == expected
            return False

    METHODS[kind][0](SHORT, 0, "cpu").fit(training_set(), Budget(), Watching())
    assert asked == expected


class _Wall:
    """A scene of a wall at z = 4 whose light rises with the square of x: 40 pixels to the scene unit there."""

    device = torch.device("cpu")

    def see(self, origins: torch.Tensor, directions: torch.Tensor, offsets: torch.Tensor) -> RaysSeen:
        x = origins[:, 0] + 4.0 * directions[:, 0]
        light = 0.05 + 0.05 * x.square()
        opacity, places = torch.ones(len(x)), torch.full((1, len(x)), 4.0)
        return RaysSeen(
            light.pow(1 / 2.2)[:, None].expand(-1, 3), opacity, opacity[None], places, opacity[None], places
        )

    def render(self, camera) -> Rendering:
        return Rendering(np.zeros((camera.height, camera.width, 3), np.float32), np.full((1, 1), 4.0, np.float32))


def test_a_wall_through_points_of_a_lens() -> None:
    """Of a disc of radius R the mean of x^2 is R^2 / 4 more; R in scene units on the wall."""
    camera, lens = cameras()[0], PhysicalLens(60.0, 0.1, WIDTH)
    wall = _Wall()
    found = through_points(wall, camera, lens, 100).image.astype(np.float64)[..., 0] ** 2.2
    plain = through_points(wall, camera, PhysicalLens(0.0, 0.1, WIDTH), 1).image.astype(np.float64)[..., 0] ** 2.2
    radius = float(lens.signed_radius(np.array(1 / 4), WIDTH)) * 4.0 / camera.fx
    assert float((found - plain).mean()) == pytest.approx(0.05 * radius**2 / 4, rel=DISC_ON_PIXELS)
    half = camera.resized(WIDTH // 2, camera.height // 2)  # the same lens at half the size
    small = through_points(wall, half, lens, 100).image.astype(np.float64)[..., 0] ** 2.2
    sharp = through_points(wall, half, PhysicalLens(0.0, 0.1, WIDTH), 1).image.astype(np.float64)[..., 0] ** 2.2
    assert float((small - sharp).mean()) == pytest.approx(0.05 * radius**2 / 4, rel=DISC_ON_FEWER_PIXELS)


@pytest.mark.slow
def test_a_photograph_has_rays_of_its_own_number() -> None:
    """Not as many as a pixel has in training."""
    method = LensNeRF({**SHORT, "lens_points": 5, "render_points": 7}, 0, "cpu")
    method.fit(training_set(), Budget(), Recorder())
    camera, lens = cameras()[1], PhysicalLens(25.0, 0.2, WIDTH)
    found = method.render(camera, lens).image
    assert np.array_equal(found, through_points(method._trained(), camera, lens, 7).image)
    assert not np.array_equal(found, through_points(method._trained(), camera, lens, 5).image)
    with pytest.raises(InputError, match="render_points"):
        LensNeRF({"render_points": 0}, 0, "cpu")


@pytest.mark.slow
def test_a_scattered_view_is_the_sharp_view_defocused() -> None:
    method, _ = trained("patch")
    camera, lens = cameras()[1], PhysicalLens(25.0, 0.2, WIDTH)
    sharp = method.render(camera, None)
    expected = defocus_numpy(sharp.image, sharp.depth, lens, method._options.patches.blur)[0]
    np.testing.assert_allclose(method.render(camera, lens).image, expected.clip(0, 1), atol=FLOAT32_VALUE)
    assert np.array_equal(method.sketch(sharp, lens).image, method.render(camera, lens).image)


@pytest.mark.slow
def test_a_sketch_is_about_the_photograph() -> None:
    method = LensNeRF({**SHORT, "render_points": 64}, 0, "cpu")
    method.fit(training_set(), Budget(), Recorder())
    camera, lens = cameras()[1], PhysicalLens(25.0, 0.2, WIDTH)
    assert isinstance(method, Sketches)
    sharp, photograph = method.render(camera, None), method.render(camera, lens).image
    sketch = method.sketch(sharp, lens).image
    inner = np.s_[4:-4, 4:-4]  # at the border the sketch lacks light from beside it
    error, blur = (np.abs(one[inner] - photograph[inner]).mean() for one in (sketch, sharp.image))
    assert error < blur / 3


@pytest.mark.parametrize("changes", [{"lens": False}, {"lens_range": "render"}, {"lens_clip": True}])
def test_options_that_a_field_has_not(changes: dict) -> None:
    with pytest.raises(InputError, match="option lens"):
        LensNeRF(changes, 0, "cpu")
