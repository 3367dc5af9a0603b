"""The tone curve by Triton against its definition."""

from __future__ import annotations

import math

import pytest
import torch
from gpu_agreement import assert_agrees

from dofbench.runtime.ops import load

TOE = 0.5 / 255


@pytest.mark.parametrize("exponent", [0.25, 1 / 2.2, 1.0, 2.2, 4.0])
def test_it_agrees_with_the_definition(exponent: float) -> None:
    values = torch.cat([torch.rand(1500) * 1.7 - 0.2, torch.tensor([0.0, 1.0, -1.0, 1e-6, TOE, 1e3])])
    assert_agrees(
        "tone", {"values": values}, torch.randn(len(values)), exponent=exponent, toe=TOE, slope=TOE ** (exponent - 1)
    )


def test_infinity_and_nan_pass() -> None:
    found = load("tone", "gpu")(torch.tensor([math.inf, -math.inf, math.nan]), 2.2, TOE, TOE**1.2)
    assert found[:2].tolist() == [math.inf, -math.inf] and found[2].isnan()


def test_tensors_that_it_cannot_take_are_named() -> None:
    with pytest.raises(ValueError, match="tone values: expected float32 on cpu, found torch.float64"):
        load("tone", "gpu")(torch.rand(3).double(), 2.2, TOE, TOE**1.2)
