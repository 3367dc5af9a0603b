"""The tone curve: its definition's properties, and the CPU backend against it in value and gradient."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch
from backends import compiled
from gpu_agreement import assert_agrees
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FINITE_DIFFERENCE

from dofbench.runtime.ops import load

TOE = 0.5 / 255
exponents = st.sampled_from([0.25, 1 / 2.2, 0.5, 1.0, 2.0, 2.2, 4.0])
reference, cpu = load("tone", "reference"), load("tone", "cpu")


def line(exponent: float, toe: float = TOE) -> tuple[float, float]:
    """(toe, slope) of a curve without a jump."""
    return toe, toe ** (exponent - 1)


def tones(seed: int) -> np.ndarray:
    """Numbers of all sizes, the curve's ends and the toe's neighbours among them; their count is odd."""
    rng = np.random.default_rng(seed)
    special = [0.0, 1.0, -1.0, 1e-6, 1e5, 1e-30, TOE, np.nextafter(np.float32(TOE), np.float32(0))]
    return np.concatenate([rng.uniform(-0.2, 1.5, 35), special]).astype(np.float32)


@given(st.integers(0, 2**31), exponents)
def test_gradient_of_the_definition(seed, exponent):
    values = torch.from_numpy(np.random.default_rng(seed).uniform(-1, 2, 20))
    values = values[(values - TOE).abs() > 1e-4].requires_grad_()  # the slope jumps at the toe
    torch.autograd.gradcheck(lambda x: reference(x, exponent, *line(exponent)), values, atol=FINITE_DIFFERENCE)


def test_the_definition_is_a_power_and_below_its_toe_a_line_through_zero():
    found = reference(torch.tensor([-0.5, 0.0, 0.1, 0.25, 1.0, 3.0], dtype=torch.float64), 2.0, 0.25, 0.25)
    assert found.tolist() == [-0.125, 0.0, 0.025, 0.0625, 1.0, 9.0]


@pytest.mark.parametrize("exponent", [0.25, 1 / 2.2, 1.0, 2.2, 4.0])
@compiled
def test_it_agrees_with_the_definition(backend: str, exponent: float) -> None:
    values = torch.cat([torch.rand(1500) * 1.7 - 0.2, torch.from_numpy(tones(1))])
    toe, slope = line(exponent)
    upstream = torch.randn(len(values))
    assert_agrees("tone", {"values": values}, upstream, backend=backend, exponent=exponent, toe=toe, slope=slope)


@compiled
def test_infinity_and_nan_pass(backend: str) -> None:
    values = torch.tensor([float("inf"), float("-inf"), float("nan")])
    found = load("tone", backend)(values, 2.2, *line(2.2))
    assert found[:2].tolist() == [float("inf"), float("-inf")] and found[2].isnan()


def test_shapes_stay_and_strided_tensors_are_taken():
    image = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(0))
    turned = image.transpose(0, 1).requires_grad_()
    found = cpu(turned, 2.2, *line(2.2))
    assert torch.equal(found, cpu(image, 2.2, *line(2.2)).transpose(0, 1))
    (gradient,) = torch.autograd.grad(found.sum(), turned)
    assert gradient.shape == turned.shape


def test_a_value_has_the_same_bits_wherever_it_stands_and_on_any_number_of_threads():
    values = torch.from_numpy(np.tile(tones(3), 301))
    before = numba.get_num_threads()
    results = []
    for threads in {1, before}:
        numba.set_num_threads(threads)
        given_values = values.clone().requires_grad_()
        found = cpu(given_values, 1 / 2.2, *line(1 / 2.2))
        (gradient,) = torch.autograd.grad(found.sum(), given_values)
        results += [torch.stack([found.detach(), gradient])]
    numba.set_num_threads(before)
    for result in results:
        assert torch.equal(result, results[0])
        assert torch.equal(result[:, :43], result[:, -43:])


@compiled
def test_other_tensors_are_refused(backend: str) -> None:
    with pytest.raises(ValueError, match=f"kernel tone, backend {backend}: found float64 on cpu, expected float32 on"):
        load("tone", backend)(torch.rand(3, dtype=torch.float64), 2.0, *line(2.0))
