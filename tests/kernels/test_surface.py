"""Surfaces' disparity, circles of confusion and the error of depth: against the definition, numpy, and finite
differences."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FINITE_DIFFERENCE, FLOAT32_GRADIENT, FLOAT32_VALUE, FLOAT64_VALUE
from torch import Tensor

from dofbench.runtime.ops import load

LEAST_ALPHA = 0.1
SIZES = st.integers(1, 90)


def drawn(seed: int, *shapes: tuple[int, ...]) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.rand(shape, generator=generator) for shape in shapes]


def with_gradients(function: Callable[..., Tensor], learned: list[Tensor], dtype: torch.dtype, *rest: Any) -> Any:
    """(value, gradient of each) by a random upstream gradient."""
    inputs = [one.detach().to(dtype, copy=True).requires_grad_() for one in learned]
    fixed = (one.to(dtype) if isinstance(one, Tensor) and one.is_floating_point() else one for one in rest)
    value = function(*inputs, *fixed)
    value.backward(torch.rand(value.shape, generator=torch.Generator().manual_seed(3)).to(dtype))
    return value.detach(), *(one.grad for one in inputs)


def assert_alike(op: str, learned: list[Tensor], *rest: Any, **options: Any) -> None:
    def of(backend: str, dtype: torch.dtype) -> Any:
        kernel = load("surface", backend, function=op)
        return with_gradients(lambda *inputs: kernel(*inputs, **options), learned, dtype, *rest)

    found, expected = of("cpu", torch.float32), of("reference", torch.float64)
    for one, other, tolerance in zip(found, expected, (FLOAT32_VALUE, *3 * [FLOAT32_GRADIENT]), strict=False):
        scale = max(float(other.abs().max()), 1e-6)
        assert float((one.double() - other).abs().max()) <= tolerance * scale


@given(SIZES, SIZES, st.integers(0, 10**6), st.sampled_from([0.0, 0.5, 9.0]))
def test_disparities_agree_with_the_definition(height: int, width: int, seed: int, nearer: float) -> None:
    """nearer: how much of the surfaces lies behind the camera: none, a part, all."""
    depth, alpha = drawn(seed, (height, width), (height, width))
    assert_alike("surface", [depth * 2 + 0.1 - nearer], alpha, LEAST_ALPHA)


@given(SIZES, st.integers(0, 10**6), st.booleans())
def test_circles_agree_with_the_definition(size: int, seed: int, clipped: bool) -> None:
    disparity, lens = drawn(seed, (size, 7), (2,))
    # Away from the ends of the range, on either side of which rounding may put a disparity.
    disparity = torch.where((disparity - 0.2).abs() < 0.01, 0.3, disparity)
    disparity = torch.where((disparity - 0.7).abs() < 0.01, 0.3, disparity)
    limits = (0.0, 1.0) if clipped else (-math.inf, math.inf)
    numbers = {"low": 0.2, "extent": 0.5, "scale": 6.0, "clipped": limits}
    assert_alike("circle", [disparity, lens[0] - 0.5, lens[1] - 0.5], **numbers)


@given(
    SIZES,
    st.integers(1, 300),
    st.integers(0, 10**6),
    st.booleans(),
    st.booleans(),
    st.booleans(),
    st.sampled_from([None, 0.6]),
)
def test_errors_of_depth_agree_with_the_definition(
    width: int, count: int, seed: int, squared: bool, shared: bool, weighted: bool, extent: float | None
) -> None:
    """Several samples lie in one pixel wherever there are more of them than pixels."""
    depth, alpha, weight, known, shares, place = drawn(seed, *3 * [(3, width)], *3 * [(count,)])
    at = (place * 3 * width).long().clamp(max=3 * width - 1).sort().values
    samples = at // width, at % width, known + 1, shares if shared else None, weight if weighted else None
    options = {"most": int(at.bincount().max()), "least_alpha": LEAST_ALPHA, "extent": extent, "squared": squared}
    assert_alike("known_depth", [depth + 0.5], alpha, *samples, **options)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_what_it_means_in_numpy(backend: str) -> None:
    """Formulae of the conventions, written anew: R = 0.02 W A (d - F), d between the ends of the range."""
    depth, alpha = (one.numpy() for one in drawn(4, (5, 9), (5, 9)))
    depth = depth + 0.5
    surface = alpha > LEAST_ALPHA
    disparity = np.where(surface, 1 / depth, (1 / depth[surface]).min())
    found = load("surface", backend)(torch.from_numpy(depth), torch.from_numpy(alpha), LEAST_ALPHA)
    np.testing.assert_allclose(found.numpy(), disparity, rtol=FLOAT32_VALUE)
    radius = load("surface", backend, function="circle")(
        found, torch.tensor(0.8), torch.tensor(-0.8 * 0.3), low=0.6, extent=1.3, scale=0.02 * 640
    )
    expected = 0.02 * 640 * 0.8 * ((disparity - 0.6) / 1.3 - 0.3)
    np.testing.assert_allclose(radius.numpy(), expected, atol=FLOAT32_VALUE * np.abs(expected).max())
    rows, columns, known = np.array([0, 2, 2]), np.array([3, 1, 1]), np.array([0.7, 0.9, 1.1], np.float32)
    kernel = load("surface", backend, function="known_depth")
    tensors = [torch.from_numpy(one) for one in (depth, np.ones_like(alpha), rows, columns, known)]
    options = {"most": 2, "least_alpha": LEAST_ALPHA, "squared": False}
    for extent, expected in (
        (None, np.abs(depth[rows, columns] - known).mean()),
        (0.5, np.abs(1 / depth[rows, columns] - 1 / known).mean() / 0.5),
    ):
        assert float(kernel(*tensors, None, None, extent=extent, **options)) == pytest.approx(
            expected, rel=FLOAT32_VALUE
        )


def test_the_definitions_against_finite_differences() -> None:
    depth, alpha, lens = (one.double() for one in drawn(8, (4, 6), (4, 6), (2,)))
    depth = depth + 0.5
    rows, columns, known = torch.tensor([1, 1, 3]), torch.tensor([2, 2, 5]), torch.tensor([0.6, 1.9, 0.8]).double()
    options = {"most": 2, "least_alpha": LEAST_ALPHA, "extent": 0.5, "squared": True}

    def value() -> Tensor:
        disparity = load("surface", "reference")(depth, alpha, LEAST_ALPHA)
        # The farthest surface stands for holes without a gradient of its own, so that these are left out.
        seen = torch.where(alpha > LEAST_ALPHA, disparity, 0.0)
        radius = load("surface", "reference", function="circle")(seen, lens[0], lens[1], low=0.3, extent=0.7, scale=4.0)
        error = load("surface", "reference", function="known_depth")
        return radius.square().sum() + error(depth, alpha, rows, columns, known, None, None, **options)

    learned = [depth.requires_grad_(), lens.requires_grad_()]
    gradients = torch.autograd.grad(value(), learned)
    for tensor, gradient, places in zip(learned, gradients, ([(1, 2), (3, 5), (0, 0)], [(0,), (1,)]), strict=True):
        for place in places:
            ends = []
            for step in (1e-6, -1e-6):
                with torch.no_grad():
                    tensor[place] += step
                    ends.append(float(value()))
                    tensor[place] -= step
            assert float(gradient[place]) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=FINITE_DIFFERENCE)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_pixels_without_a_surface_have_no_gradient_whatever_comes_from_behind(backend: str) -> None:
    depth = torch.tensor([[2.0, math.nan, 3.0, -1.0]], requires_grad=True)
    found = load("surface", backend)(depth, torch.tensor([[1.0, 1.0, 0.05, 1.0]]), LEAST_ALPHA)
    assert found.tolist() == [[0.5, 0.5, 0.5, 0.5]]
    found.backward(torch.tensor([[1.0, math.nan, math.inf, math.nan]]))
    assert depth.grad is not None and depth.grad.tolist() == [[-0.25, 0.0, 0.0, 0.0]]


def test_a_radius_keeps_the_shape_and_numbers_are_a_lens_too() -> None:
    for shape in ((), (3,), (2, 3, 4)):
        disparity = torch.rand(shape)
        found = load("surface", function="circle")(disparity, 2.0, -1.0, low=0.0, extent=1.0, scale=3.0)
        torch.testing.assert_close(found, 3 * (2 * disparity - 1), rtol=FLOAT32_VALUE, atol=FLOAT32_VALUE)
    exact = load("surface", function="circle")(torch.rand(3).double(), 2.0, -1.0, low=0.0, extent=1.0, scale=3.0)
    assert exact.dtype == torch.float64 and float(exact.abs().max()) < 3 + FLOAT64_VALUE


def test_tensors_that_it_cannot_take_are_named() -> None:
    with pytest.raises(ValueError, match="surface on the CPU, depth: expected float32 on cpu, found torch.float64"):
        load("surface", "cpu")(torch.ones(2, 2).double(), torch.ones(2, 2), LEAST_ALPHA)
    with pytest.raises(ValueError, match=r"surface: expected pictures of \(2, 3\) pixels, found \(3, 2\)"):
        load("surface", "cpu")(torch.ones(2, 3), torch.ones(3, 2), LEAST_ALPHA)


@pytest.mark.parametrize(("row", "column"), [(2, 0), (0, 3), (-1, 0), (0, -1)])
def test_samples_outside_the_picture_are_refused_instead_of_read(row: int, column: int) -> None:
    depth, known = torch.ones(2, 3), torch.ones(2)
    at = torch.tensor([0, row]), torch.tensor([0, column])
    options = {"most": 1, "least_alpha": LEAST_ALPHA, "extent": None, "squared": False}
    with pytest.raises(IndexError, match=r"surface: 1 samples of known depth outside \(2, 3\) pixels"):
        load("surface", "cpu", function="known_depth")(depth, depth, *at, known, None, None, **options)
