"""Masked pixels have no influence on the training of any shipped method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import Recorder
from small_scene import HEIGHT, WIDTH, cameras, training_set

from dofbench.core.budget import Budget
from dofbench.core.content import content_folder
from dofbench.core.contracts import TrainingSet
from dofbench.methods.cards import find_method

METHODS = sorted(file.parent.name for file in content_folder("methods").glob("*/method.toml"))
STEPS = 16


def masks() -> list[np.ndarray]:
    """A rectangle that moves from view to view, and single pixels."""
    found = []
    for index in range(len(cameras())):
        mask = np.ones((HEIGHT, WIDTH), bool)
        mask[6:26, 5 + 9 * index : 22 + 9 * index] = False
        mask[3::11, 2::13] = False
        found.append(mask)
    return found


def masked(contents: int) -> TrainingSet:
    """The small scene with masks, and with noise of a seed of its own under them."""
    random, whole = np.random.default_rng(contents), training_set()
    views = []
    for view, mask in zip(whole.views, masks(), strict=True):
        image = view.image.copy()
        image[~mask] = random.uniform(size=(np.count_nonzero(~mask), 3))
        views.append(replace(view, image=image, mask=mask))
    return TrainingSet(tuple(views), whole.points)


def trained(name: str, given: TrainingSet) -> tuple[np.ndarray, list[float]]:
    """(a rendering after a few steps, the losses)."""
    entry, recorder = find_method(name), Recorder()
    _, options, _ = entry.preset("smoke")
    method = entry.create({**options, "steps": STEPS}, 0, "cpu")
    method.fit(given, Budget(steps=STEPS), recorder)
    return method.render(cameras()[0], None).image, recorder.losses


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_what_is_under_a_mask_changes_no_bit(name: str) -> None:
    (one, losses), (two, same) = trained(name, masked(1)), trained(name, masked(2))
    assert losses == same and np.array_equal(one, two)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["3dgs", "nerf"])
def test_a_mask_is_not_its_pixels_filled_and_trained_on(name: str) -> None:
    filled = TrainingSet(tuple(replace(view, mask=None) for view in masked(1).views), masked(1).points)
    assert trained(name, filled)[1] != trained(name, masked(1))[1]
