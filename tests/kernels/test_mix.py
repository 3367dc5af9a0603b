"""Pixels mixed from their neighbours: against the definition, convolution by scipy, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from backends import compiled
from gpu_agreement import assert_agrees
from scipy.ndimage import correlate
from tolerances import FINITE_DIFFERENCE, FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.runtime.ops import load

cpu, reference = load("mix", "cpu"), load("mix", "reference")


def drawn(height: int, width: int, channels: int, size: int, seed: int, spread: float = 2.0) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    image = torch.rand(height, width, channels, generator=generator)
    return [image, spread * torch.randn(height, width, size * size, generator=generator)]


def with_gradients(kernel, given_tensors, dtype, seed=3):
    inputs = [tensor.detach().to(dtype, copy=True).requires_grad_() for tensor in given_tensors]
    mixed = kernel(*inputs)
    weight = torch.rand(mixed.shape, generator=torch.Generator().manual_seed(seed)).to(dtype)
    (mixed * weight).sum().backward()
    return mixed.detach(), *(tensor.grad for tensor in inputs)


@pytest.mark.parametrize(
    ("height", "width", "channels", "size"), [(7, 21, 3, 3), (3, 4, 5, 5), (1, 1, 1, 3), (20, 19, 2, 9), (9, 1, 4, 3)]
)
@compiled
def test_it_agrees_with_the_definition(backend: str, height: int, width: int, channels: int, size: int) -> None:
    image, logits = drawn(height, width, channels, size, 0, spread=3.0)
    assert_agrees("mix", {"image": image, "logits": logits}, torch.randn_like(image), backend=backend)


@compiled
def test_large_logits_do_not_overflow(backend: str) -> None:
    logits = torch.full((2, 3, 9), -500.0)
    logits[..., 4] = 500.0
    image = torch.rand(2, 3, 3)
    assert torch.equal(load("mix", backend)(image, logits), image)


@compiled
def test_a_logit_that_is_not_a_number_is_found_in_its_pixel_alone(backend: str) -> None:
    logits = torch.randn(3, 4, 9)
    logits[1, 2, 5] = torch.nan
    found = load("mix", backend)(torch.rand(3, 4, 3), logits).isnan().all(2)
    assert found[1, 2] and found.sum() == 1


@pytest.mark.parametrize("kernel", [cpu, reference])
def test_one_kernel_for_all_pixels_is_a_convolution(kernel) -> None:
    """scipy's correlation with zeros around, of a kernel without any symmetry."""
    image, _ = drawn(17, 23, 3, 5, 1)
    weights = np.random.default_rng(2).uniform(0.1, 1, (5, 5))
    weights /= weights.sum()
    logits = torch.from_numpy(np.log(weights).ravel()).float().expand(17, 23, 25).contiguous()
    found = kernel(image, logits)
    for channel in range(3):
        expected = correlate(image[..., channel].double().numpy(), weights, mode="constant")
        np.testing.assert_allclose(found[..., channel].numpy(), expected, atol=FLOAT32_VALUE)


def test_every_pixel_has_a_kernel_of_its_own() -> None:
    """Each pixel takes the neighbour that is named by its own row and column."""
    image, _ = drawn(9, 12, 3, 3, 4)
    choice = np.add.outer(np.arange(9), 2 * np.arange(12)) % 9
    logits = torch.full((9, 12, 9), -200.0)
    logits[np.arange(9)[:, None], np.arange(12), choice] = 0.0
    padded = np.pad(image.numpy(), ((1, 1), (1, 1), (0, 0)))
    rows, columns = np.mgrid[:9, :12]
    expected = padded[rows + choice // 3, columns + choice % 3]
    np.testing.assert_array_equal(cpu(image, logits).numpy(), expected)


def test_reference_against_finite_differences() -> None:
    image, logits = (tensor.double() for tensor in drawn(4, 5, 2, 3, 8))
    weight = torch.rand(4, 5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    _, by_image, by_logits = with_gradients(lambda *given: reference(*given) * weight, (image, logits), torch.float64)
    weighed = weight * torch.rand(weight.shape, generator=torch.Generator().manual_seed(3)).double()
    for tensor, gradient in ((image, by_image), (logits, by_logits)):
        for place in [(0, 0, 0), (2, 3, 1), (3, 4, 1)]:
            ends = []
            for step in (1e-6, -1e-6):
                tensor[place] += step
                ends.append(float((reference(image, logits) * weighed).sum()))
                tensor[place] -= step
            assert float(gradient[place]) == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=FINITE_DIFFERENCE)


def test_a_mean_of_equal_pixels_is_that_pixel_away_from_the_rim() -> None:
    logits = drawn(11, 11, 3, 5, 6)[1].double()
    found = reference(torch.full((11, 11, 3), 0.7, dtype=torch.float64), logits)
    np.testing.assert_allclose(found[2:-2, 2:-2].numpy(), 0.7, rtol=FLOAT64_VALUE)
    assert float(found[0].max()) < 0.7  # beside the image it is black


@pytest.mark.parametrize("kernel", [cpu, reference])
@pytest.mark.parametrize(
    ("image", "logits", "words"),
    [
        ((4, 5, 3), (4, 5, 4), "square of an odd number"),
        ((4, 5, 3), (4, 5, 8), "square of an odd number"),
        ((4, 5, 3), (5, 4, 9), r"expected \(H, W, K \* K\)"),
        ((4, 5), (4, 5, 9), r"expected \(H, W, K \* K\)"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(kernel, image, logits, words) -> None:
    with pytest.raises(ValueError, match=words):
        kernel(torch.zeros(image), torch.zeros(logits))


def test_another_type_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="mix logits: expected torch.float32 on cpu like image, found torch.float64"):
        cpu(torch.zeros(4, 5, 3), torch.zeros(4, 5, 9).double())
