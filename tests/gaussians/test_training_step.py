"""Parts of a training step: to which stage time and bad numbers are attributed, and the order of photographs."""

import math
import time

import numpy as np
import pytest
import torch
from small_scene import cameras, options, training_set

from dofbench.training.common.monitor import NonFiniteError, Place, StageClock
from dofbench.training.common.views import LEAST_VIEWS, OutlierOptions, ViewOrder
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
    with pytest.raises(NonFiniteError, match="step 4, view v0, gradient by the rendering"):
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


@pytest.mark.parametrize("wanted", [True, False])
def test_an_outlier_is_left_out_from_its_time_on(wanted):
    count = LEAST_VIEWS + 1
    order, random = ViewOrder(count, OutlierOptions(outlier_views=wanted, outliers_from=0.5)), np.random.default_rng(0)
    for _ in range(2):
        for view in range(count):
            order.record(view, 9.0 if view == 4 else 1.0 + 0.01 * view)
    assert {order.next(0.4, random) for _ in range(count)} == set(range(count))
    late = {order.next(0.5, random) for _ in range(count - wanted)}
    assert order.left_out == ({4} if wanted else set()) and (4 in late) is not wanted
