"""What lies behind a scene that is seen from all around."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import Recorder, cloud, frontal
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError, Status
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.field_options import FieldOptions, RayOptions
from dofbench.training.fields.field_scene import FieldScene, Surroundings, on_square
from dofbench.training.fields.field_trainer import FieldTrainer
from dofbench.training.fields.grid_field import GridField, GridOptions
from dofbench.training.fields.ray_model import RayModel
from dofbench.training.fields.space import AnnealedSpace
from dofbench.training.fields.unbounded import Unbounded

PARTS = st.floats(-1, 1).filter(lambda part: abs(part) > 1e-3)
DIRECTIONS = st.tuples(PARTS, PARTS, PARTS)


def direction_at(u: float, v: float) -> np.ndarray:
    """The direction that lies at a place of the square, from the faces of the octahedron |x| + |y| + |z| = 1."""
    if abs(u) + abs(v) <= 1:
        found = np.array([u, v, 1 - abs(u) - abs(v)])
    else:
        found = np.array([math.copysign(1 - abs(v), u), math.copysign(1 - abs(u), v), 1 - abs(u) - abs(v)])
    return found / np.linalg.norm(found)


@given(DIRECTIONS, st.floats(0.1, 10))
def test_a_direction_has_one_place_on_the_square(direction: tuple[float, float, float], length: float) -> None:
    found = on_square(length * torch.tensor([direction], dtype=torch.float64))[0].tolist()
    expected = np.array(direction) / np.linalg.norm(direction)
    np.testing.assert_allclose(direction_at(*found), expected, atol=FLOAT64_VALUE)


@given(DIRECTIONS)
def test_colours_are_interpolated_on_the_square(direction: tuple[float, float, float]) -> None:
    logits = torch.randn(49, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    directions = torch.tensor([direction], dtype=torch.float64)
    found = Surroundings(logits).seen(directions)
    grid = logits.T.reshape(1, 3, 7, 7)
    places = on_square(directions)[None, None]
    expected = torch.nn.functional.grid_sample(grid, places, align_corners=True)[0, :, 0].T
    torch.testing.assert_close(found, torch.sigmoid(expected), rtol=0, atol=FLOAT64_VALUE)


def test_the_corners_of_the_square_are_on_it() -> None:
    """Straight down lies at the corners, straight up in the middle, whatever the signs of zeros."""
    down, up = torch.tensor([[0.0, 0.0, -1.0], [-0.0, -0.0, -1.0]]), torch.tensor([[0.0, 0.0, 1.0]])
    assert on_square(down).abs().tolist() == [[1, 1], [1, 1]] and on_square(up).tolist() == [[0, 0]]
    assert bool(torch.isfinite(Surroundings.grey(2).seen(torch.cat([down, up]))).all())


def test_gradients_are_those_of_the_four_nodes_around() -> None:
    made = Surroundings(torch.randn(25, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)))
    directions = torch.randn(4, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))

    def seen(logits: torch.Tensor) -> torch.Tensor:
        made.logits = logits
        return made.seen(directions)

    assert torch.autograd.gradcheck(seen, made.logits)
    made.logits.grad = None
    made.seen(directions[:1]).sum().backward()
    assert int((made.logits.grad != 0).any(1).sum()) == 4


@pytest.mark.parametrize("shape", [(10, 3), (1, 3), (9, 4), (9,)])
def test_what_is_not_a_square_of_colours(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="surroundings: expected"):
        Surroundings(torch.zeros(shape))


@pytest.mark.parametrize(("shift", "share"), [(-60.0, 1.0), (60.0, 0.0)])
def test_light_from_behind_passes_what_the_field_lets_through(shift: float, share: float) -> None:
    """All of it through an empty field, none through a full one."""
    options = FieldOptions(rays=RayOptions(cells=4, ray_samples=20))
    shape = options.grid.shape((6, 5, 4))
    field = GridField.at_random(shape, shift, torch.Generator().manual_seed(0))
    space = Unbounded(np.array([-1.0, -1.0, 1.0]), np.array([1.0, 1.0, 5.0]), 0.0)
    behind = Surroundings(torch.randn(16, 3, generator=torch.Generator().manual_seed(1)))
    origins, directions = torch.tensor([[0.2, 0.1, 0.0], [9.0, 9.0, 0.0]]), torch.tensor([[0.0, 0.1, 1.0]]).repeat(2, 1)
    with_it, without = (
        FieldScene(field, space, options, one).see(origins, directions, torch.full((2,), 0.5)) for one in (behind, None)
    )
    colours = behind.seen(directions)
    expected = without.color + share * colours
    torch.testing.assert_close(with_it.color, expected, rtol=0, atol=FLOAT32_VALUE)
    assert torch.equal(with_it.opacity, without.opacity)


def around(count: int, first: float = 0.0) -> list[Camera]:
    """Cameras on a circle of radius 4 that look at its centre."""
    cameras = []
    for angle in first + 2 * math.pi * np.arange(count) / count:
        pose = np.eye(4)
        pose[:3, :3] = [[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]]
        pose[2, 3] = 4.0
        cameras.append(Camera(24, 18, 27.0, 27.0, 12.0, 9.0, pose))
    return cameras


def photograph(camera: Camera) -> np.ndarray:
    """Nothing but what is infinitely far away: colours that change with the direction."""
    columns, rows = np.meshgrid(np.arange(24) + 0.5, np.arange(18) + 0.5)
    x, y = camera.rays(columns.ravel(), rows.ravel())
    directions = np.stack([x, y, np.ones_like(x)], 1) @ camera.camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (0.5 + 0.4 * np.sin(3 * directions)).reshape(18, 24, 3).astype(np.float32)


def photographs() -> TrainingSet:
    xyz = np.random.default_rng(0).normal(size=(200, 3)) * 0.3
    views = tuple(TrainingView(f"v{n}", camera, photograph(camera)) for n, camera in enumerate(around(6)))
    return TrainingSet(views, cloud(xyz))


SHORT = {"steps": 300, "batch_pixels": 256, "ray_samples": 24, "grid_nodes": 24, "grid_nodes_first": 16, "cells": 8}


def trained(shown: TrainingSet) -> FieldMethod:
    method = FieldMethod({**SHORT, "surroundings_nodes": 16}, 0, "cpu")
    assert method.fit(shown, Budget(), Recorder()).status is Status.OK
    return method


def error(method: FieldMethod) -> float:
    """Mean squared error of a camera between those that it was trained on."""
    (camera,) = around(1, first=0.5)
    return float(np.square(method.render(camera, None).image - photograph(camera)).mean())


@pytest.mark.parametrize(("turned", "share"), [(True, 0.2), (False, 1.0)])
def test_rates_rise_from_nothing_where_views_are_from_all_around(turned: bool, share: float) -> None:
    """At the third of 100 steps a fifth of the whole rate there, elsewhere all of it; both decay to a twentieth."""
    shown = photographs()
    if not turned:  # beside each other instead, behind the points
        views = tuple(
            replace(view, camera=frontal(24, 18, 27.0, (0.1 * n, 0, 0))) for n, view in enumerate(shown.views)
        )
        shown = TrainingSet(views, cloud(shown.points.xyz + [0, 0, 4.0]))
    options = FieldOptions.of(**SHORT | {"steps": 100, "lr_final": 0.05})
    trainer = FieldTrainer(shown, options, RayModel(), 0)
    trainer.fit(Budget(), Recorder(3))
    (rate,) = {group["lr"] for group in trainer._optimiser.param_groups if group["first"] == options.rates.grid_lr}
    assert rate == pytest.approx(share * options.rates.grid_lr * 0.05**0.02, rel=FLOAT64_VALUE)


@pytest.mark.slow
def test_rays_begin_farther_away_while_training_begins() -> None:
    """At the first of 300 steps, at the second, and when all of them are taken."""
    shown, near = photographs(), []
    for stop in (1, 2, 300):
        trainer = FieldTrainer(shown, FieldOptions.of(**SHORT), RayModel(), 0)
        trainer.fit(Budget(), Recorder(stop))
        assert isinstance(trainer.scene.space, Unbounded)
        near.append(trainer.scene.space.near)
    whole = AnnealedSpace.of(around(6), shown.points)
    assert isinstance(whole.whole, Unbounded) and near[2] == whole.whole.near
    assert near[0] == near[1] == pytest.approx((whole.middle + near[2]) / 2, rel=FLOAT64_VALUE) and near[0] > near[2]


@pytest.mark.slow
def test_what_lies_behind_is_learned_and_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method = trained(photographs())
    method.save(tmp_path)
    again = FieldMethod({}, 0, "cpu")
    again.load(tmp_path)
    assert error(again) == error(method)
    monkeypatch.setattr(Unbounded, "has_surroundings", False)
    assert error(trained(photographs())) > 5 * error(method)


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["surroundings", "space_box_low", "space_near"])
def test_a_field_that_an_earlier_version_stored_is_one_line(tmp_path: Path, missing: str) -> None:
    """Its box was all that it had: neither anything behind it nor space around it, and it began at the camera."""
    trained(photographs()).save(tmp_path)
    arrays = dict(np.load(tmp_path / "field.npz"))
    arrays["space_older"] = arrays.pop(missing)
    np.savez(tmp_path / "field.npz", **arrays)
    with pytest.raises(InputError, match=missing.removeprefix("space_")):
        FieldMethod({}, 0, "cpu").load(tmp_path)


def test_too_few_nodes_are_one_line() -> None:
    with pytest.raises(InputError, match="option surroundings_nodes: found 1, expected at least 2"):
        replace(GridOptions(), surroundings_nodes=1)
