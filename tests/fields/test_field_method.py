"""A radiance field learns a small scene, repeats bit for bit, is stored and read, and stops at the first bad number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import Recorder
from small_scene import HEIGHT, WIDTH, cameras, training_set
from tolerances import FLOAT32_VALUE

from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError, Status
from dofbench.core.lens import PhysicalLens
from dofbench.training.fields.field_method import FieldMethod
from dofbench.training.fields.field_trainer import FieldTrainer
from dofbench.training.fields.ray_model import RayModel

SHORT = {
    "steps": 120,
    "batch_pixels": 256,
    "ray_samples": 32,
    "grid_nodes": 48,
    "grid_nodes_first": 24,
    "grid_grows": 1,
    "cells": 16,
    "cells_from": 0.4,
    "cells_every": 10,
    "density_shift": -3.0,
}


def trained(shown: TrainingSet | None = None, seed: int = 0, **changes: object) -> tuple[FieldMethod, Recorder]:
    method, recorder = FieldMethod({**SHORT, **changes}, seed, "cpu"), Recorder()
    outcome = method.fit(shown or training_set(), Budget(), recorder)
    assert outcome.status is Status.OK
    return method, recorder


@pytest.mark.slow
def test_it_learns_the_photographs_and_the_planes() -> None:
    method, recorder = trained(steps=400)
    assert np.mean(recorder.losses[-20:]) < 0.3 * np.mean(recorder.losses[:20])
    for view in training_set().views:
        rendering = method.render(view.camera, None)
        assert rendering.image.shape == (HEIGHT, WIDTH, 3) and rendering.depth.shape == (HEIGHT, WIDTH)
        assert float(np.square(rendering.image - view.image).mean()) < 0.03


@pytest.mark.slow
def test_the_same_seed_gives_the_same_field_and_another_seed_another() -> None:
    images = [trained(seed=seed)[0].render(cameras()[0], None).image for seed in (3, 3, 4)]
    assert np.array_equal(images[0], images[1]) and not np.array_equal(images[0], images[2])


def test_looking_at_it_in_between_changes_nothing() -> None:
    class Looking(Recorder):
        def after_step(self, step: int, loss: float) -> bool:
            watched.render(cameras()[1], None)
            return super().after_step(step, loss)

    watched = FieldMethod(SHORT, 0, "cpu")
    watched.fit(training_set(), Budget(steps=20), Looking())
    alone = FieldMethod(SHORT, 0, "cpu")
    alone.fit(training_set(), Budget(steps=20), Recorder())
    assert np.array_equal(watched.render(cameras()[0], None).image, alone.render(cameras()[0], None).image)


def test_predicting_a_training_view_changes_nothing_and_repeats() -> None:
    everywhere = np.ones((HEIGHT, WIDTH), bool)

    class Predicting(Recorder):
        def after_step(self, step: int, loss: float) -> bool:
            watched.predict_photograph(shown.views[1].name, everywhere)
            return super().after_step(step, loss)

    shown, changes = training_set(), {**SHORT, "colour_per_view": "affine"}
    watched, alone = FieldMethod(changes, 0, "cpu"), FieldMethod(changes, 0, "cpu")
    watched.fit(shown, Budget(steps=20), Predicting())
    alone.fit(shown, Budget(steps=20), Recorder())
    predictions = [method.predict_photograph(shown.views[1].name, everywhere) for method in (watched, alone, alone)]
    assert np.array_equal(predictions[0], predictions[1]) and np.array_equal(predictions[1], predictions[2])


def test_a_prediction_has_the_view_s_learned_colours(tmp_path: Path) -> None:
    shown, everywhere = training_set(), np.ones((HEIGHT, WIDTH), bool)
    views = tuple(
        replace(view, image=(view.image * (0.6 if number == 0 else 1.0)).astype(np.float32))
        for number, view in enumerate(shown.views)
    )
    method, _ = trained(replace(shown, views=views), colour_per_view="gain")
    gain = method.colour_estimates()[views[0].name].diagonal()
    method._trainer.colours._kind = "off"
    plain = method.predict_photograph(views[0].name, everywhere)
    method._trainer.colours._kind = "gain"
    np.testing.assert_allclose(method.predict_photograph(views[0].name, everywhere), plain * gain, rtol=FLOAT32_VALUE)
    assert gain.max() < 0.99
    method.save(tmp_path)
    method.load(tmp_path)
    with pytest.raises(RuntimeError, match="isn't trained here"):
        method.predict_photograph(views[0].name, everywhere)


def test_a_stored_field_renders_the_same(tmp_path: Path) -> None:
    method, _ = trained()
    method.save(tmp_path)
    again = FieldMethod({}, 0, "cpu")
    again.load(tmp_path)
    for camera in cameras():
        one, other = method.render(camera, None), again.render(camera, None)
        assert np.array_equal(one.image, other.image) and np.array_equal(one.depth, other.depth)


@pytest.mark.parametrize("damage", ["missing", "text", "cut", "other"])
def test_a_damaged_file_is_one_line(tmp_path: Path, damage: str) -> None:
    method, _ = trained(steps=2)
    method.save(tmp_path)
    path = tmp_path / "field.npz"
    if damage == "missing":
        path.unlink()
    elif damage == "text":
        path.write_text("no field")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:5000])
    else:
        arrays = dict(np.load(path))
        np.savez(path, **{**arrays, "nodes": arrays["nodes"] + 1})
    with pytest.raises(InputError, match=r"field\.npz"):
        FieldMethod({}, 0, "cpu").load(tmp_path)


def test_a_bad_pixel_ends_training_at_once_with_the_photograph_s_name() -> None:
    """A step draws 16 of 5184 pixels, so the first step that drew the bad one would come late."""
    method = FieldMethod({**SHORT, "batch_pixels": 16}, 0, "cpu")
    outcome = method.fit(training_set(bad_view=1), Budget(), Recorder())
    assert outcome.status is Status.DIVERGED and outcome.steps == 1
    assert [(event.step, event.view, event.stage) for event in outcome.nonfinite] == [(1, "v1", "photograph")]
    assert np.isfinite(method.render(cameras()[0], None).image).all()


@pytest.mark.parametrize(("what", "value", "stage"), [("basis", np.nan, "rays"), ("density", 1e25, "loss")])
def test_a_bad_number_in_the_field_ends_training_with_its_step(what: str, value: float, stage: str) -> None:
    """NaN shows in the colours. The square of 10^25 is infinite, and is in the term that keeps the grid smooth."""

    class Spoiling(Recorder):
        def after_step(self, step: int, loss: float) -> bool:
            if step == 3:
                with torch.no_grad():
                    method._trained().field.parameters[what].view(-1)[11] = value
            return super().after_step(step, loss)

    method = FieldMethod({**SHORT, "smooth_every": 1}, 0, "cpu")
    outcome = method.fit(training_set(), Budget(), Spoiling())
    assert outcome.status is Status.DIVERGED and outcome.steps == 4
    assert [(event.step, event.stage) for event in outcome.nonfinite] == [(4, stage)]


def test_without_points_there_is_no_place() -> None:
    with pytest.raises(InputError, match="sparse points"):
        FieldMethod(SHORT, 0, "cpu").fit(TrainingSet(training_set().views, None), Budget(), Recorder())


def test_it_has_no_lens() -> None:
    method, _ = trained(steps=2)
    assert method.lens_estimates() is None
    with pytest.raises(ValueError, match="no lens"):
        method.render(cameras()[0], PhysicalLens(1.0, 0.2, WIDTH))
    with pytest.raises(RuntimeError, match="fit or load"):
        FieldMethod({}, 0, "cpu").render(cameras()[0], None)


@pytest.mark.slow
def test_photographs_of_other_colours_are_explained_by_colours_of_their_own(tmp_path: Path) -> None:
    """Of three photographs one is darker and one warmer. With colours the field learns what all have in common."""
    given, errors = training_set(), {}
    factors = np.array([[0.8, 0.8, 0.8], [1.2, 1.2, 1.0], [1.0, 1.0, 1.2]], np.float32)
    shown = TrainingSet(
        tuple(
            TrainingView(view.name, view.camera, view.image * factor)
            for view, factor in zip(given.views, factors, strict=True)
        ),
        given.points,
    )
    for chosen in ("off", "gain"):
        method, _ = trained(shown, steps=400, colour_per_view=chosen)
        predictions = [method.render(view.camera, None).image for view in given.views]
        errors[chosen] = np.mean(
            [np.abs(one - view.image).mean() for one, view in zip(predictions, given.views, strict=True)]
        )
        folder = tmp_path / chosen
        folder.mkdir()
        method.save(folder)
        again = FieldMethod({}, 0, "cpu")
        again.load(folder)
        if chosen == "off":
            assert method.colour_estimates() is None and again.colour_estimates() is None
    assert errors["gain"] < errors["off"]
    found, read = method.colour_estimates(), again.colour_estimates()
    assert found is not None and read is not None and list(found) == list(read) == ["v0", "v1", "v2"]
    assert all(np.array_equal(found[name], read[name]) for name in found)
    assert found["v0"][0, 0] < 0.95 < 1.05 < found["v1"][0, 0] and found["v2"][2, 2] > 1.05


def test_a_bad_number_in_a_colour_is_told() -> None:
    options = FieldMethod({**SHORT, "colour_per_view": "gain"}, 0, "cpu").options
    trainer = FieldTrainer(training_set(), options, RayModel(), 0)
    trainer.colours._table.values[1] = float("nan")
    outcome = trainer.fit(Budget(), Recorder())
    assert [(event.step, event.stage) for event in outcome.nonfinite] == [(1, "loss")]


def test_time_ends_it_too() -> None:
    class Clock(Recorder):
        def seconds(self) -> float:
            return 0.2 * len(self.losses)

    method = FieldMethod(SHORT, 0, "cpu")
    assert method.fit(training_set(), Budget(seconds=1.0), Clock()).steps == 5
