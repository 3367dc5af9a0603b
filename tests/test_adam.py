"""Adam's step: its definition beside torch's optimiser, and the CPU's backend beside both."""

from __future__ import annotations

import pytest
import torch
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE
from torch import Tensor

from dofbench.kernels import load

RATE, EPSILON = 0.03, 1e-9


def begun(dtype: torch.dtype, count: int = 1500) -> tuple[Tensor, list[Tensor]]:
    """Values, and the gradients of four steps, of many magnitudes."""
    random = torch.Generator().manual_seed(0)
    values = torch.randn(count, generator=random, dtype=torch.float64)
    sizes = 10 ** (8 * torch.rand(4, count, generator=random, dtype=torch.float64) - 6)
    gradients = sizes * torch.randn(4, count, generator=random, dtype=torch.float64)
    return values.to(dtype), list(gradients.to(dtype))


def steps(backend: str, dtype: torch.dtype, rate: float = RATE) -> list[Tensor]:
    """The values after each step."""
    values, gradients = begun(dtype)
    moments = torch.zeros_like(values), torch.zeros_like(values)
    found = []
    for step, gradient in enumerate(gradients, 1):
        load("adam", backend)(values, gradient, *moments, step=step, rate=rate * step, epsilon=EPSILON)
        found.append(values.clone())
    return found


def steps_of_torch(dtype: torch.dtype, **kind: bool) -> list[Tensor]:
    values, gradients = begun(dtype)
    values.requires_grad_()
    optimiser = torch.optim.Adam([values], eps=EPSILON, **kind)
    found = []
    for step, gradient in enumerate(gradients, 1):
        optimiser.param_groups[0]["lr"] = RATE * step
        values.grad = gradient
        optimiser.step()
        found.append(values.detach().clone())
    return found


def test_the_definition_is_adam() -> None:
    """By torch's plain optimiser in float64."""
    for found, expected in zip(steps("reference", torch.float64), steps_of_torch(torch.float64), strict=True):
        torch.testing.assert_close(found, expected, rtol=FLOAT64_VALUE, atol=FLOAT64_VALUE)


def test_the_cpu_s_is_torch_s_fused_one_to_the_bit() -> None:
    for found, expected in zip(steps("cpu", torch.float32), steps_of_torch(torch.float32, fused=True), strict=True):
        assert torch.equal(found, expected)


def test_the_cpu_s_agrees_with_the_definition() -> None:
    for found, expected in zip(steps("cpu", torch.float32), steps("reference", torch.float64), strict=True):
        assert float((found - expected).abs().max()) < FLOAT32_VALUE * float(expected.abs().max())


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_a_scalar_that_is_one_has_nothing_changed(backend: str) -> None:
    values, (gradient, *_) = begun(torch.float32)
    tensors = values, gradient, torch.full_like(values, 0.5), torch.full_like(values, 0.25)
    before = [tensor.clone() for tensor in tensors]
    gradient[7] = torch.nan
    load("adam", backend)(*tensors, step=1, rate=RATE, epsilon=EPSILON, unless=torch.ones(()))
    assert all(torch.equal(*pair) for k, pair in enumerate(zip(tensors, before, strict=True)) if k != 1)
    gradient[7] = 0.0
    load("adam", backend)(*tensors, step=1, rate=RATE, epsilon=EPSILON, unless=torch.zeros(()))
    assert not any(torch.equal(*pair) for k, pair in enumerate(zip(tensors, before, strict=True)) if k != 1)


def test_wrong_arguments_are_named() -> None:
    values = torch.zeros(3)
    call = load("adam")
    with pytest.raises(ValueError, match=r"^adam second: expected shape \(3,\), found \(4,\)$"):
        call(values, values, values, torch.zeros(4), step=1, rate=1.0, epsilon=0.0)
    with pytest.raises(ValueError, match=r"^adam: expected a step of at least 1, found 0$"):
        call(values, values, values, values, step=0, rate=1.0, epsilon=0.0)
    with pytest.raises(ValueError, match=r"^adam on the CPU: expected float32 on cpu, found torch.float64 on cpu$"):
        load("adam", "cpu")(*[values.double()] * 4, step=1, rate=1.0, epsilon=0.0)
