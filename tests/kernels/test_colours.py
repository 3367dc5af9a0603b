"""The colour transform against the definition, numpy, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from backends import compiled, every
from gpu_agreement import assert_agrees
from tolerances import FINITE_DIFFERENCE, FLOAT32_VALUE
from torch import Tensor

from dofbench.runtime.ops import load


def drawn(height: int, width: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """A picture, a change of its colours, and a gradient by the result."""
    generator = torch.Generator().manual_seed(seed)
    image, upstream = (torch.rand(height, width, 3, generator=generator) for _ in range(2))
    return image, torch.rand(3, 4, generator=generator) - 0.5, upstream


def with_gradients(backend: str, image: Tensor, change: Tensor, upstream: Tensor) -> tuple[Tensor, ...]:
    inputs = [one.detach().clone().requires_grad_() for one in (image, change)]
    found = load("colours", backend)(*inputs)
    return found.detach(), *torch.autograd.grad(found, inputs, upstream)


@pytest.mark.parametrize(("height", "width"), [(30, 37), (1, 1), (90, 61)])
@compiled
def test_it_agrees_with_the_definition(backend: str, height: int, width: int) -> None:
    image, change, upstream = drawn(height, width, 0)
    assert_agrees("colours", {"image": image, "change": change}, upstream, backend=backend)


@compiled
def test_a_channel_that_is_not_a_number_is_found_in_its_pixel_alone(backend: str) -> None:
    image = torch.rand(3, 4, 3)
    image[1, 2, 0] = torch.nan
    found = load("colours", backend)(image, torch.rand(3, 4)).isnan().any(2)
    assert found[1, 2] and found.sum() == 1


@every
def test_each_channel_is_mixed_by_its_row(backend: str) -> None:
    image, change, _ = drawn(4, 5, 1)
    matrix = np.eye(3) + change[:, :3].numpy()
    expected = np.einsum("rc,yxc->yxr", matrix, image.numpy()) + change[:, 3].numpy()
    np.testing.assert_allclose(load("colours", backend)(image, change).numpy(), expected, atol=FLOAT32_VALUE)


def test_the_definition_against_finite_differences() -> None:
    image, change, upstream = (one.double() for one in drawn(3, 4, 2))
    _, *gradients = with_gradients("reference", image, change, upstream)
    for tensor, gradient in zip((image, change), gradients, strict=True):
        for place in [(0, 0), (2, 3), (1, 2)]:
            ends = []
            for step in (1e-6, -1e-6):
                tensor[place] += step
                ends.append(float((load("colours", "reference")(image, change) * upstream).sum()))
                tensor[place] -= step
            # Of a pixel all three channels are moved at once.
            assert float(gradient[place].sum()) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=FINITE_DIFFERENCE)


def test_views_of_larger_pictures_are_taken() -> None:
    image, change, _ = drawn(6, 8, 3)
    view = image.permute(1, 0, 2)[::2]
    found = load("colours", "cpu")(view, change)
    torch.testing.assert_close(found, load("colours", "reference")(view, change), rtol=0, atol=FLOAT32_VALUE)


def test_tensors_that_it_cannot_take_are_named() -> None:
    with pytest.raises(ValueError, match="colours change: expected torch.float32 on cpu like image, found"):
        load("colours", "cpu")(torch.ones(2, 2, 3), torch.zeros(3, 4).double())
