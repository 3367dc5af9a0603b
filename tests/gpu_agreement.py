"""A compiled backend and the definition: values and gradients of one call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tolerances import FLOAT32_GRADIENT, FLOAT32_VALUE
from torch import Tensor

from dofbench.runtime.ops import load


def called(function: Callable[..., Tensor], inputs: dict[str, Tensor], upstream: Tensor | None, **options: Any):
    """(value, gradient of each input), float64. upstream: gradient of the value; None where it is one number."""
    inputs = {name: value.detach().clone().requires_grad_() for name, value in inputs.items()}
    value = function(*inputs.values(), **options)
    value.backward(None if upstream is None else upstream.to(value))
    return value.detach().double(), {name: one.grad.double() for name, one in inputs.items()}


def assert_agrees(
    op: str,
    inputs: dict[str, Tensor],
    upstream: Tensor | None = None,
    *,
    backend: str = "gpu",
    function: str | None = None,
    **options: Any,
) -> None:
    """The backend in float32 against the definition in float64, relative to the largest magnitude. inputs: float32, in
    the order of the function's arguments."""
    exact_options = {name: _exact(one) for name, one in options.items()}
    exact = {name: value.double() for name, value in inputs.items()}
    expected, expected_gradients = called(load(op, "reference", function=function), exact, upstream, **exact_options)
    found, gradients = called(load(op, backend, function=function), inputs, upstream, **options)
    assert distance(found, expected) < FLOAT32_VALUE
    for name, gradient in gradients.items():
        assert distance(gradient, expected_gradients[name]) < FLOAT32_GRADIENT, name


def _exact(option: Any) -> Any:
    return option.double() if isinstance(option, Tensor) and option.is_floating_point() else option


def distance(found: Tensor, expected: Tensor) -> float:
    """Largest difference over largest magnitude; NaN where a number is one."""
    return float((found - expected).abs().max() / expected.abs().max().clamp_min(torch.finfo(torch.float64).tiny))
