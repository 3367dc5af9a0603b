"""Adam's Triton kernel, interpreted, against its float64 definition."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up import cloud
from test_adam import EPSILON, RATE, Several, begun, steps
from tolerances import FLOAT32_VALUE

from dofbench.runtime.gpu_launch import recorded
from dofbench.runtime.ops import load
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.optimiser import GaussianOptimiser, RateOptions


def test_steps_agree_with_the_definition() -> None:
    """More numbers than one program has, and not a multiple of what it has."""
    for found, expected in zip(steps("gpu", torch.float32), steps("reference", torch.float64), strict=True):
        assert float((found - expected).abs().max()) < FLOAT32_VALUE * float(expected.abs().max())


@pytest.mark.parametrize("finite", [False, True])
def test_a_step_on_several_tensors_is_one_on_each(finite: bool) -> None:
    """Of several sizes, one with a gradient by some of its rows alone."""
    ours, theirs = Several.drawn(torch.float32), Several.drawn(torch.float64)
    if finite:
        for one in (ours, theirs):
            one.gradients[0][3], one.gradients[4][1, 0], one.gradients[7][0] = torch.nan, torch.inf, -torch.inf
    found, expected = ours.step("gpu", finite=finite), theirs.step("reference", finite=finite)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one.double(), other, rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)


def test_the_gaussians_parameters_are_moved_by_one_launch() -> None:
    gaussians = Gaussians.from_points(cloud(np.eye(4, 3)), 1, "cpu")
    for parameter in gaussians.parameters.values():
        parameter.grad = torch.ones_like(parameter)
    optimiser = GaussianOptimiser(gaussians, RateOptions(), 1.0)
    optimiser._adam = load("adam", "gpu")
    with recorded() as launches:
        optimiser.step(0.0)
    assert list(launches.values()) == [1]


@pytest.mark.parametrize("found_inf", [0.0, 1.0])
def test_a_scalar_that_is_one_has_nothing_changed(found_inf: float) -> None:
    values, (gradient, *_) = begun(torch.float32, 70)
    ours, theirs = ([values.clone(), gradient, torch.ones(70), torch.ones(70)] for _ in range(2))
    options = {"steps": [3], "lrs": [RATE], "eps": EPSILON, "found_inf": torch.tensor(found_inf)}
    load("adam", "gpu")(*([one] for one in ours), **options)
    load("adam", "reference")(*([one] for one in theirs), **options)
    for found, expected in zip(ours, theirs, strict=True):
        torch.testing.assert_close(found, expected, rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)
    assert torch.equal(ours[0], values) == (found_inf == 1.0)


def test_a_gradient_of_any_layout_is_taken_and_a_parameter_is_not() -> None:
    values, moments = torch.zeros(5, 4), (torch.zeros(5, 4), torch.zeros(5, 4))
    gradient = torch.arange(1.0, 21.0).reshape(4, 5).T
    arguments, options = [[one] for one in (gradient, *moments)], {"steps": [1], "lrs": [RATE], "eps": EPSILON}
    load("adam", "gpu")([values], *arguments, **options)
    torch.testing.assert_close(moments[0], 0.1 * gradient, rtol=FLOAT32_VALUE, atol=0.0)
    with pytest.raises(ValueError, match="^adam param: expected a contiguous tensor, found strides"):
        load("adam", "gpu")([torch.zeros(4, 5).T], *arguments, **options)
