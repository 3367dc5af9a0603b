"""Parts of a training step and its state: times, bad numbers, the order of views, snapshots, devices."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np
import pytest
import torch
from small_scene import cameras, options, training_set
from torch import Tensor

from dofbench.training.common.lenses import LearnedLenses, lens_ties
from dofbench.training.common.monitor import NonFiniteError, Place, StageClock
from dofbench.training.common.views import OutlierOptions, ViewOrder
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.training_state import TrainingState
from dofbench.training.gaussians.training_step import StepRasteriser


def test_time_within_another_stage_counts_to_its_own_alone(monkeypatch):
    now = iter([0.0, 1.0, 4.0, 10.0, 20.0, 21.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(now))
    clock = StageClock()
    with clock.timed("lens"), clock.timed("rasterise"):
        pass
    with clock.timed("lens"):
        pass
    assert clock.seconds == {"rasterise": 3.0, "lens": 7.0 + 1.0}


def test_a_stage_that_fails_is_counted_and_leaves_the_clock_in_order(monkeypatch):
    now = iter([0.0, 2.0, 10.0, 11.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(now))
    clock = StageClock()
    with pytest.raises(ZeroDivisionError), clock.timed("loss"):
        raise ZeroDivisionError
    with clock.timed("optimiser"):
        pass
    assert clock.seconds == {"loss": 2.0, "optimiser": 1.0}


def test_the_innermost_stage_of_a_bad_number_is_named():
    place = Place(3, "v1")
    with pytest.raises(NonFiniteError) as caught, place.located("lens"), place.located("rasterise"):
        raise FloatingPointError("NaN in means")
    event = caught.value.event
    assert (event.step, event.view, event.stage, event.detail) == (3, "v1", "rasterise", "NaN in means")


def test_one_number_is_told_by_its_value_and_many_by_their_count() -> None:
    place = Place(3, "v1")
    with pytest.raises(NonFiniteError, match=r"^step 3, view v1, loss: loss is nan$"):
        place.check(torch.tensor(math.nan), "loss")
    with pytest.raises(NonFiniteError, match=r"^step 3, view v1, image: 2 of 3 values$"):
        place.check(torch.tensor([math.nan, 1.0, math.inf]), "image")


def test_gradients_wait_at_the_cut_until_they_are_passed_on():
    state = TrainingState(training_set(), options(), 0)
    scene = StepRasteriser(state, 1.0, Place(1, "v0"), StageClock())
    first, second = (scene.rasterise(camera, "depth") for camera in cameras()[:2])
    first.color.sum().backward()
    means = state.gaussians.parameters["means"]
    assert means.grad is None
    scene.backward()
    assert means.grad.any() and second.color.grad is None
    # Density control gets the statistics of those rasterisations alone that gradients passed through.
    assert torch.equal(scene.statistics().grad_2d, scene._statistics[0].grad_2d)


def test_a_bad_gradient_is_named_before_it_reaches_the_gaussians():
    state = TrainingState(training_set(), options(), 0)
    scene = StepRasteriser(state, 1.0, Place(4, "v0"), StageClock())
    raster = scene.rasterise(cameras()[0], "none")
    (raster.color * torch.full_like(raster.color, float("nan"))).sum().backward()
    with pytest.raises(NonFiniteError, match="step 4, view v0, gradient with respect to the rendering"):
        scene.backward()
    assert state.gaussians.parameters["means"].grad is None


def test_every_photograph_is_looked_at_once_a_round():
    order, random = ViewOrder(5, OutlierOptions()), np.random.default_rng(0)
    rounds = [[order.next(0.0, random) for _ in range(5)] for _ in range(3)]
    assert all(sorted(one) == list(range(5)) for one in rounds) and rounds[0] != rounds[1]


def test_a_round_goes_on_where_it_was():
    order, random = ViewOrder(5, OutlierOptions()), np.random.default_rng(0)
    order.next(0.0, random)
    state = order.state()
    rest = [order.next(0.0, random) for _ in range(4)]
    order.restore(state)
    assert [order.next(0.0, random) for _ in range(4)] == rest


def test_a_snapshot_brings_back_what_training_changes() -> None:
    state = TrainingState(training_set(), options(colour_per_view="gain"), 0)
    assert state.lenses is not None and state.loss is None
    state.loss = torch.tensor(0.5)
    kept = state.snapshot()

    def drawn() -> tuple[float, float, list[int]]:
        order = [state.order.next(0.5, state.random) for _ in range(4)]
        return float(torch.rand(1, generator=state.generator)), float(state.random.uniform()), order

    first = drawn()
    lens, begun = state.lenses.aperture_and_focus(1), state.gaussians.parameters["means"].detach().clone()
    filtered = None if state.gaussians.filter_3d is None else state.gaussians.filter_3d.clone()
    assert drawn() != first
    state.lenses.spoil(0.25)
    state.loss = torch.tensor(0.1)
    state.revise({"lens": False, "adaptation": "off"})
    with torch.no_grad():
        state.gaussians.parameters["means"] += 1
    state.gaussians.filter_3d = None
    for _ in range(2):  # a snapshot stays usable
        state.restore(kept)
        assert state.options.lens.lens and state.lenses is not None and state.loss == 0.5
        assert state.lenses.aperture_and_focus(1) == lens
        assert torch.equal(state.gaussians.parameters["means"], begun)
        assert filtered is not None and torch.equal(state.gaussians.filter_3d, filtered)
        again = drawn()
        assert again[:2] == first[:2] and np.array_equal(again[2], first[2])
        state.gaussians.filter_3d.zero_()


@pytest.fixture
def state(monkeypatch: pytest.MonkeyPatch) -> TrainingState:
    """On `meta`, without the 3D filter, which asks for numbers that nothing on `meta` has."""
    monkeypatch.setattr(Gaussians, "update_filter_3d", lambda self, cameras: None)
    return TrainingState(training_set(), options(colour_per_view="affine"), 0, "meta")


def tensors(thing: object, seen: set[int]) -> Iterator[Tensor]:
    """Every tensor that an object holds, at any depth."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, Tensor):
        yield thing
    elif isinstance(thing, dict):
        for value in thing.values():
            yield from tensors(value, seen)
    elif isinstance(thing, list | tuple):
        for value in thing:
            yield from tensors(value, seen)
    elif type(thing).__module__.startswith(("dofbench.", "torch.optim")):
        yield from tensors(getattr(thing, "__dict__", {}), seen)


def devices(thing: object) -> set[str]:
    return {tensor.device.type for tensor in tensors(thing, set())}


def test_every_tensor_of_a_state_lies_there(state: TrainingState) -> None:
    # Parameters, sums, and of colours and both parts of lenses three each.
    assert len(list(tensors(state, set()))) == 6 + 2 + 3 * 3
    assert devices(state) == {"meta"}


def test_so_do_shared_lenses_children_and_a_new_start(state: TrainingState, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LearnedLenses, "aperture_and_focus", lambda self, view: (0.5, 0.5))
    assert devices(state.lenses.shared(lens_ties(training_set().views, "scene"))) == {"meta"}
    parents = {name: value.detach()[:3] for name, value in state.gaussians.parameters.items()}
    children = state.density._children(parents)
    assert devices(children) == {"meta"} and children["means"].shape == (6, 3)
    state.start_from(training_set().points)
    assert devices(state) == {"meta"}


def test_the_same_children_are_drawn_wherever_they_lie(state: TrainingState) -> None:
    """The generator is one of the host: a seed's numbers don't depend on the device."""
    host = TrainingState(training_set(), options(), 0)
    before = host.generator.get_state()
    for one in (host, state):
        one.density._children({name: value.detach()[:3] for name, value in one.gaussians.parameters.items()})
    assert not torch.equal(host.generator.get_state(), before)
    assert torch.equal(host.generator.get_state(), state.generator.get_state())
