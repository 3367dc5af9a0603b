import numpy as np
import pytest
import torch
from tolerances import FLOAT32_VALUE, LENS_FOUND

from dofbench.core.lens import DisparityRange, Lens
from dofbench.training.common.lenses import LearnedLenses, LensOptions

RANGE = DisparityRange(0.02, 0.06)


def _train(lenses, target, steps, order):
    for step in range(steps):
        index = order[step % len(order)]
        slope, offset = lenses.forward(index)
        ((slope - target[0]) ** 2 + (offset + target[0] * target[1]) ** 2).backward()
        lenses.step(index, step / steps)


@pytest.mark.parametrize("activation", ["relu", "log", "ends"])
@pytest.mark.parametrize("update", ["view", "dense"])
def test_each_view_finds_its_lens(activation, update):
    options = LensOptions(lens_activation=activation, lens_update=update, lens_lr=2e-2, lens_lr_final=1e-4)
    lenses = LearnedLenses(2, RANGE, options)
    _train(lenses, (0.9, 0.2), 2000, [0, 1])
    for index in range(2):
        found = Lens.from_physical(lenses.estimate(index, 504), RANGE)
        assert abs(found.aperture - 0.9) < LENS_FOUND and abs(found.focus - 0.2) < LENS_FOUND


def test_dense_update_is_adam_over_the_whole_vector():
    options = LensOptions(lens_update="dense", lens_lr=1e-2, lens_lr_final=1e-2)
    lenses = LearnedLenses(3, RANGE, options)
    vector = torch.full((3, 2), 0.5, requires_grad=True)
    adam = torch.optim.Adam([vector], lr=1e-2, eps=1e-15)
    for step in range(30):
        index = step % 3
        slope, offset = lenses.forward(index)
        ((slope - 1) ** 2 + (offset + 0.1) ** 4).backward()
        lenses.step(index, 0.0)
        adam.zero_grad()
        row = torch.relu(vector[index]) + 1e-5
        ((row[0] - 1) ** 2 + (0.1 - row[0] * row[1]) ** 4).backward()
        adam.step()
    assert np.allclose(lenses.state()["raw"], vector.detach().numpy(), atol=FLOAT32_VALUE)


def test_the_estimate_does_not_depend_on_the_methods_own_range():
    """The same physical lens comes out whichever disparity range the method trained in."""
    truth = Lens(0.7, 0.3).physical(RANGE, 504)
    for own in (RANGE, DisparityRange(0.01, 0.09)):
        inside = Lens.from_physical(truth, own)
        lenses = LearnedLenses(
            1,
            own,
            LensOptions(lens_activation="log", lens_init_aperture=inside.aperture, lens_init_focus=inside.focus),
        )
        found = Lens.from_physical(lenses.estimate(0, 504), RANGE)
        assert found.aperture == pytest.approx(0.7, abs=FLOAT32_VALUE)
        assert found.focus == pytest.approx(0.3, abs=FLOAT32_VALUE)


def test_a_closed_lens_keeps_the_least_aperture():
    """The released code adds 1e-5 behind the relu: A is never less, and F never below it."""
    lenses = LearnedLenses(1, RANGE, LensOptions(lens_activation="relu"))
    lenses.spoil(-0.3)
    slope, offset = lenses.forward(0)
    assert float(slope.detach()) == pytest.approx(1e-5, rel=FLOAT32_VALUE)
    assert float(offset.detach()) == pytest.approx(-1e-10, rel=FLOAT32_VALUE)
    lenses.spoil(0.3)
    slope, offset = lenses.forward(0)
    assert float(slope.detach()) == pytest.approx(0.30001, rel=FLOAT32_VALUE / 10)
    assert float(offset.detach()) == pytest.approx(-(0.30001**2), rel=FLOAT32_VALUE / 10)
