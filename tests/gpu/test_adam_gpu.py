"""Adam's Triton kernel, interpreted, against its float64 definition."""

from __future__ import annotations

import pytest
import torch
from test_adam import EPSILON, RATE, begun, steps
from tolerances import FLOAT32_VALUE

from dofbench.kernels import load


def test_steps_agree_with_the_definition() -> None:
    """More numbers than one program has, and not a multiple of what it has."""
    for found, expected in zip(steps("gpu", torch.float32), steps("reference", torch.float64), strict=True):
        assert float((found - expected).abs().max()) < FLOAT32_VALUE * float(expected.abs().max())


@pytest.mark.parametrize("unless", [0.0, 1.0])
def test_a_scalar_that_is_one_has_nothing_changed(unless: float) -> None:
    values, (gradient, *_) = begun(torch.float32, 70)
    ours, theirs = ([values.clone(), gradient, torch.ones(70), torch.ones(70)] for _ in range(2))
    options = {"step": 3, "rate": RATE, "epsilon": EPSILON, "unless": torch.tensor(unless)}
    load("adam", "gpu")(*ours, **options)
    load("adam", "reference")(*theirs, **options)
    for found, expected in zip(ours, theirs, strict=True):
        torch.testing.assert_close(found, expected, rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)
    assert torch.equal(ours[0], values) == (unless == 1.0)


def test_a_gradient_of_any_layout_is_taken_and_a_parameter_is_not() -> None:
    values, moments = torch.zeros(5, 4), (torch.zeros(5, 4), torch.zeros(5, 4))
    gradient = torch.arange(1.0, 21.0).reshape(4, 5).T
    load("adam", "gpu")(values, gradient, *moments, step=1, rate=RATE, epsilon=EPSILON)
    torch.testing.assert_close(moments[0], 0.1 * gradient, rtol=FLOAT32_VALUE, atol=0.0)
    with pytest.raises(ValueError, match="^adam values: expected a contiguous tensor, found strides"):
        load("adam", "gpu")(torch.zeros(4, 5).T, gradient, *moments, step=1, rate=RATE, epsilon=EPSILON)
