"""The display encoding: one pair of functions, with a toe where gradients pass and without where tones are stated."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE

from dofbench.core.images import to_8bit, to_16bit
from dofbench.optics.tone import TOE, decode, encode, fast_decode, fast_encode

gammas = st.sampled_from([1.0, 2.0, 2.2, 4.0])


@given(st.floats(0, 8), gammas)
def test_unless_told_it_is_the_pure_power_of_arrays_and_tensors(value, gamma):
    for x in (np.float64(value), np.array(value), torch.tensor(value, dtype=torch.float64)):
        assert float(decode(x, gamma)) == pytest.approx(value**gamma)
        assert float(encode(x, gamma)) == pytest.approx(value ** (1 / gamma))
        assert float(encode(decode(x, gamma), gamma)) == pytest.approx(value, rel=FLOAT32_VALUE)


@given(st.floats(-1, 100), gammas)
def test_encoding_undoes_decoding(value, gamma):
    x = torch.tensor([value], dtype=torch.float64)
    assert float(encode(decode(x, gamma, toe=TOE), gamma, toe=TOE)) == pytest.approx(
        value, rel=FLOAT64_VALUE, abs=FLOAT64_VALUE
    )


def test_what_eight_bits_can_hold_is_decoded_by_the_pure_power():
    levels = torch.arange(256, dtype=torch.float64) / 255
    assert torch.equal(decode(levels, 2.2, toe=TOE), levels**2.2)


@pytest.mark.parametrize("gamma", [2.0, 2.2])
def test_the_gradient_is_finite_at_black_and_below(gamma):
    for function in (decode, encode):
        x = torch.tensor([-0.5, -1e-9, 0.0, 1e-30, 1e-9, TOE, 0.5, 1.0, 7.0], requires_grad=True)
        function(x, gamma, toe=TOE).sum().backward()
        assert torch.isfinite(x.grad).all() and (x.grad > 0).all()


@given(st.integers(0, 2**31), gammas)
def test_compiled_powers_are_the_same_function(seed, gamma):
    rng = np.random.default_rng(seed)
    values = np.concatenate([rng.uniform(-0.2, 1.5, 37), [0.0, TOE, 1.0, 1e-6, 1e5]]).astype(np.float32)
    for function, fast in ((decode, fast_decode), (encode, fast_encode)):
        found = torch.from_numpy(values).requires_grad_()
        expected = torch.from_numpy(values).double().requires_grad_()
        a, b = fast(found, gamma, "cpu"), function(expected, gamma, toe=TOE)
        a.sum().backward()
        b.sum().backward()
        torch.testing.assert_close(a.double(), b, rtol=FLOAT32_VALUE, atol=0)
        torch.testing.assert_close(found.grad.double(), expected.grad, rtol=FLOAT32_VALUE, atol=0)


def test_the_fast_curves_have_the_toe_whatever_computes_them():
    x = torch.tensor([-0.5, 0.0, TOE**2.2 / 2, TOE / 2, TOE, 0.5, 1.5], dtype=torch.float64)
    for fast, curve in ((fast_decode, decode), (fast_encode, encode)):
        expected = curve(x, 2.2, toe=TOE)
        assert torch.equal(fast(x, 2.2), expected) and torch.equal(fast(x, 2.2, "reference"), expected)
        torch.testing.assert_close(fast(x.float(), 2.2).double(), expected, rtol=FLOAT32_VALUE, atol=0)


def test_arrays_and_tensors_have_the_same_toe():
    x = np.array([-0.1, 0.0, TOE**2.2 / 3, TOE / 3, TOE, 0.7])
    for curve in (decode, encode):
        np.testing.assert_allclose(curve(x, toe=TOE), curve(torch.from_numpy(x), toe=TOE).numpy(), rtol=FLOAT64_VALUE)


def test_what_the_toe_changes_is_below_the_first_level_of_8_bits_and_no_more_than_is_said():
    """The numbers in the module's docstring, gamma 2.2."""
    tones = np.geomspace(1e-12, TOE * (1 - 1e-9), 200_001)
    light = decode(tones)
    pure, straight = encode(light), encode(light, toe=TOE)
    assert not to_8bit(pure).any() and not to_8bit(straight).any()
    assert math.ceil(1e5 * np.abs(pure - straight).max()) == 56
    levels = np.abs(to_16bit(pure).astype(int) - to_16bit(straight).astype(int))
    assert 35 <= levels.max() <= 37
    assert math.ceil(1e8 * np.abs(light - decode(tones, toe=TOE)).max()) == 32
    above = np.linspace(TOE, 2, 1001)
    assert np.array_equal(decode(above), decode(above, toe=TOE)) and np.array_equal(
        encode(above), encode(above, toe=TOE)
    )
