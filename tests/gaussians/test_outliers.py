"""Photographs that don't belong to the scene are left out, and none of a scene that is hard to learn."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up import Recorder
from small_scene import options, training_set

from dofbench.core.budget import Budget
from dofbench.core.contracts import TrainingSet
from dofbench.training.common.views import MOST, VISITS, OutlierOptions, OutlierViews, ViewOrder
from dofbench.training.gaussians.trainer import Trainer


def _found(losses, visits=VISITS):
    views = OutlierViews(len(losses))
    for _ in range(visits):
        for view, loss in enumerate(losses):
            views.record(view, loss)
    return views.found()


def test_a_loss_far_above_the_others_is_an_outlier():
    losses = list(0.05 + 0.001 * np.arange(12))
    assert _found(losses) == set()
    losses[4] = 0.2
    assert _found(losses) == {4}
    assert _found(losses, VISITS - 1) == set()  # not seen often enough


@given(st.lists(st.floats(0.05, 0.069), min_size=8, max_size=30))
def test_losses_that_differ_by_less_than_two_fifths_have_none(losses):
    assert _found(losses) == set()


def test_no_more_than_a_share_is_left_out_the_worst_first():
    losses = [0.05] * 12 + [0.5, 0.9, 0.6, 0.8, 0.7]
    assert len(_found(losses)) == int(MOST * len(losses)) == 4 and _found(losses) == {13, 14, 15, 16}
    assert _found([0.05] * 5 + [0.9] * 2) == set()  # too few views for a meaningful median


def test_a_photograph_of_something_else_is_trained_on_no_more():
    """A training set of copies of three views, in which one photograph is replaced by noise."""
    given_set, random = training_set(), np.random.default_rng(0)
    views = [replace(given_set.views[number % 3], name=f"v{number}") for number in range(9)]
    views[5] = replace(views[5], image=random.uniform(size=views[5].image.shape).astype(np.float32))
    chosen = options(steps=80, lens=False, adaptation="off", normal_weight=0, outlier_views=True)
    trainer = Trainer(TrainingSet(tuple(views), given_set.points), chosen, 0)
    trainer.fit(Budget(), Recorder())
    assert trainer.left_out_views == {5}


def test_a_photograph_that_was_hardly_seen_keeps_all_in():
    """Two visits of every photograph are needed; until then none is left out, whatever the others' losses say."""
    views = OutlierViews(12)
    for view in range(12):
        for _ in range(1 if view == 5 else 2):
            views.record(view, 0.9 if view == 4 else 0.05)
    assert views.found() == set()
    views.record(5, 0.05)
    assert views.found() == {4}


@pytest.mark.parametrize(("progress", "left_out"), [(0.29, set()), (0.3, {4})])
def test_outliers_are_left_out_from_their_share_of_the_training_on(progress, left_out):
    order = ViewOrder(12, OutlierOptions(outlier_views=True, outliers_from=0.3))
    for view in range(12):
        for _ in range(2):
            order.record(view, 0.9 if view == 4 else 0.05)
    seen = [order.next(progress, np.random.default_rng(0)) for _ in range(11)]
    assert order.left_out == left_out and set(seen) & left_out == set()
