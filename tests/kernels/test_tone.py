"""The tone curve: its definition's properties, and the CPU backend against it in value and gradient."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FINITE_DIFFERENCE, FLOAT32_VALUE

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


@given(st.integers(0, 2**31), exponents)
def test_the_cpu_agrees_with_the_definition(seed, exponent):
    found = torch.from_numpy(tones(seed)).requires_grad_()
    expected = found.detach().double().requires_grad_()
    upstream = torch.from_numpy(np.random.default_rng(seed).standard_normal(len(found)))
    a, b = cpu(found, exponent, *line(exponent)), reference(expected, exponent, *line(exponent))
    a.backward(upstream.float())
    b.backward(upstream.float().double())
    torch.testing.assert_close(a.double(), b, rtol=FLOAT32_VALUE, atol=0)
    torch.testing.assert_close(found.grad.double(), expected.grad, rtol=FLOAT32_VALUE, atol=0)


def test_infinity_and_nan_pass():
    found = cpu(torch.tensor([float("inf"), float("-inf"), float("nan")]), 2.2, *line(2.2))
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


@pytest.mark.parametrize("values", [torch.rand(3, dtype=torch.float64), torch.rand(3, device="meta")])
def test_other_tensors_are_refused(values):
    with pytest.raises(ValueError, match="expected float32 on cpu"):
        cpu(values, 2.0, *line(2.0))
