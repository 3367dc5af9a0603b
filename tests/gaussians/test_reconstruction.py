"""A reconstruction as a source of depth: its spread, its confidence, and what is kept of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import frontal, scene_of
from small_scene import cameras, training_set
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.scenes.scene import Scene
from dofbench.training.gaussians import scene_fit
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.scene_fit import OPTIONS, Reconstruction, SplatDepth, Surface, reconstruct

CAMERA = frontal(16, 12, 12.0)


def reconstruction(depths: list[float], opacities: list[float]) -> Reconstruction:
    """Large round Gaussians on the optical axis, one behind the other."""
    count = len(depths)
    means = torch.zeros(count, 3)
    means[:, 2] = torch.tensor(depths)
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1
    gaussians = Gaussians(
        {
            "means": means,
            "log_scales": torch.log(torch.tensor(depths))[:, None].repeat(1, 3) + np.log(0.5),
            "quaternions": quaternions,
            "opacity_logits": torch.logit(torch.tensor(opacities)),
            "sh_dc": torch.zeros(count, 3),
            "sh_rest": torch.zeros(count, 0, 3),
        }
    )
    return Reconstruction(gaussians, OPTIONS.with_overrides({"filter_3d": False}))


def test_one_surface_has_no_spread():
    surface = reconstruction([2.0], [0.9]).surface(CAMERA)
    assert surface.spread[6, 8] < FLOAT32_GRADIENT
    # A deviation of 6 pixels, widened by the 2D filter, half a pixel from the pixel's centre along both axes.
    variance = 36 + OPTIONS.appearance.filter_2d
    expected = 0.9 * 36 / variance * np.exp(-0.5 * (0.5**2 + 0.5**2) / variance)
    assert surface.alpha[6, 8] == pytest.approx(expected, rel=FLOAT32_GRADIENT)


def test_spread_is_the_deviation_of_what_is_blended():
    """Weights and disparities by hand, at the pixel in the middle."""
    surface = reconstruction([2.0, 4.0], [0.5, 0.8]).surface(CAMERA)
    near, far = (reconstruction([z], [a]).surface(CAMERA).alpha[6, 8] for z, a in ((2.0, 0.5), (4.0, 0.8)))
    weights = np.array([near, (1 - near) * far])
    share = weights / weights.sum()
    disparity = np.array([0.5, 0.25])
    expected = np.sqrt(share @ disparity**2 - (share @ disparity) ** 2)
    assert surface.alpha[6, 8] == pytest.approx(weights.sum(), rel=FLOAT32_GRADIENT)
    assert surface.spread[6, 8] == pytest.approx(expected, rel=FLOAT32_GRADIENT)


def test_gaussians_behind_the_camera_change_no_digit_of_the_spread():
    """They and one at the near plane, whose disparity is far above that of what is seen."""
    alone = reconstruction([2.0, 2.1], [0.5, 0.8])
    parameters = {name: value.repeat(2, *[1] * (value.ndim - 1)) for name, value in alone.gaussians.parameters.items()}
    parameters["means"][2:, 2] = torch.tensor([-1000.0, alone.gaussians.near])
    crowded = Reconstruction(Gaussians(parameters), OPTIONS.with_overrides({"filter_3d": False}))
    expected, found = alone.surface(CAMERA), crowded.surface(CAMERA)
    assert expected.spread.any() and np.array_equal(found.spread, expected.spread)


def test_nothing_is_unknown():
    surface = reconstruction([2.0], [0.05]).surface(CAMERA)
    assert (surface.depth == 0).all() and (surface.spread == 0).all()


def test_a_manifest_has_the_options_that_are_not_as_usual():
    usual, changed = (OPTIONS.with_overrides({"depth_every": every}) for every in (1, 7))
    found = [Reconstruction(reconstruction([2.0], [0.9]).gaussians, one).settings() for one in (usual, changed)]
    assert found[1] == {**found[0], "depth_every": 7} and "depth_every" not in found[0]
    assert not {"clone_place", "lens_clip"} & set(found[1])


def small_scene() -> Scene:
    """The scene on which trainings take a second, as one on disk would be: two planes at 3 and 6."""
    given, scene = training_set(), scene_of(cameras())
    views = [
        replace(view, image=lambda image=shown.image: image)
        for view, shown in zip(scene.views, given.views, strict=True)
    ]
    return replace(scene, views=tuple(views), points=given.points)


def test_a_reconstruction_is_made_once_and_read_back_from_then_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, told = small_scene(), []
    made = SplatDepth.make(scene, steps=40, seed=3, work=tmp_path, progress=lambda *done: told.append(done))
    assert told == [(step, 40) for step in range(1, 41)]
    assert made.provenance()["steps"] == 40 == made.provenance()["options"]["steps"] and made.provenance()["seed"] == 3
    monkeypatch.setattr(scene_fit, "reconstruct", lambda *_, **__: pytest.fail("trained again"))
    again = SplatDepth.make(scene, steps=40, seed=3, work=tmp_path)
    one, other = (source.estimate(scene.views[0]) for source in (made, again))
    assert np.array_equal(one.depth, other.depth) and np.array_equal(one.confidence, other.confidence)
    # The points stand at 3 and 6, and the training begins at them: what is seen lies there, or is blended of both.
    low, high = np.quantile(one.depth[one.depth > 0], [0.05, 0.95])
    assert 2.5 < low < high < 6.5


def test_a_scene_without_points_is_refused() -> None:
    with pytest.raises(InputError, match="a Gaussian reconstruction"):
        reconstruct(replace(small_scene(), points=None), steps=2, seed=0)


def test_a_training_that_diverges_is_no_reconstruction() -> None:
    scene = small_scene()
    bad = np.full((36, 48, 3), np.nan, np.float32)
    views = [replace(view, image=lambda: bad) for view in scene.views]
    with pytest.raises(FloatingPointError, match="scene: reconstruction diverged"):
        reconstruct(replace(scene, views=tuple(views)), steps=2, seed=0)


def test_confidence_by_hand() -> None:
    """Opacity over 1 + (s / 5 % of the range)^2; the range is that from the 5th to the 95th per cent of disparity."""
    disparity = np.linspace(1.0, 3.0, 101).reshape(1, 101)  # the range is 1.1 to 2.9; scene units below 1
    alpha = np.full(disparity.shape, 0.8)
    alpha[0, 7] = 1.0 + 1e-6
    spread = np.linspace(0.0, 0.3, 101).reshape(1, 101)
    depth = (1 / disparity).astype(np.float32)
    depth[0, 50] = 0.0

    class Fixed(Reconstruction):
        def __init__(self) -> None:
            """Nothing was trained."""

        def surface(self, camera: object) -> Surface:
            return Surface(depth, alpha, spread)

    found = SplatDepth(Fixed(), {}).estimate(scene_of([CAMERA]).views[0])
    low, high = np.percentile(np.delete(disparity, 50), [5, 95])
    expected = np.minimum(alpha, 1) / (1 + (spread / (0.05 * (high - low))) ** 2)
    expected[0, 50] = 0.0
    assert np.array_equal(found.depth, depth) and found.confidence.dtype == np.float32
    assert np.allclose(found.confidence, expected, rtol=FLOAT32_VALUE)
