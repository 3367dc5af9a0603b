"""Surfaces' disparity, circles of confusion and the error of depth: against the definition, numpy, and finite
differences."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
import torch
from backends import GPU, compiled, every
from gpu_agreement import assert_agrees
from tolerances import FINITE_DIFFERENCE, FLOAT32_VALUE, FLOAT64_VALUE
from torch import Tensor

from dofbench.runtime.ops import load

LEAST_ALPHA = 0.1


def drawn(seed: int, *shapes: tuple[int, ...]) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.rand(shape, generator=generator) for shape in shapes]


@compiled
@pytest.mark.parametrize("nearer", [0.0, 0.5, 9.0])
def test_disparities_agree_with_the_definition(backend: str, nearer: float) -> None:
    """More pixels than one program has; with all surfaces before the camera, some, and none."""
    depth = 2 * torch.rand(40, 37) + 0.1 - nearer
    options = {"alpha": torch.rand(40, 37), "least_alpha": LEAST_ALPHA}
    assert_agrees("surface", {"depth": depth}, torch.randn_like(depth), backend=backend, **options)


@compiled
@pytest.mark.parametrize("clipped", [(-math.inf, math.inf), (0.0, 1.0)])
def test_circles_agree_with_the_definition(backend: str, clipped: tuple[float, float]) -> None:
    disparity = torch.rand(40, 37)
    disparity = torch.where(((disparity - 0.2).abs() < 0.01) | ((disparity - 0.7).abs() < 0.01), 0.3, disparity)
    inputs = {"disparity": disparity, "slope": torch.tensor(0.8), "offset": torch.tensor(-0.3)}
    numbers = {"low": 0.2, "extent": 0.5, "scale": 6.0, "clipped": clipped}
    assert_agrees("surface", inputs, torch.randn_like(disparity), backend=backend, function="circle", **numbers)


@compiled
@pytest.mark.parametrize(
    ("shared", "weighted", "extent", "squared"),
    list(product((False, True), (False, True), (None, 0.6), (False, True))),
)
def test_errors_of_depth_agree_with_the_definition(
    backend: str, shared: bool, weighted: bool, extent: float | None, squared: bool
) -> None:
    """More samples than one program has, several of them in one pixel."""
    at = torch.randint(300, (1400,)).sort().values
    samples = {"rows": at // 20, "columns": at % 20}
    given = {"known": torch.rand(len(at)) + 1, "shares": torch.rand(len(at)), "weight": torch.rand(15, 20)}
    given |= {} if shared else {"shares": None}
    given |= {} if weighted else {"weight": None}
    options = {"most": int(at.bincount().max()), "least_alpha": LEAST_ALPHA, "extent": extent, "squared": squared}
    assert_agrees(
        "surface", {"depth": torch.rand(15, 20) + 0.5}, function="known_depth", backend=backend,
        alpha=torch.rand(15, 20), **samples, **given, **options,
    )  # fmt: skip


@compiled
def test_samples_of_a_pixel_are_added_up_over_the_border_of_programs(backend: str) -> None:
    """All but the first and the last sample lie in one pixel, whose first sample adds up those of several programs."""
    at = torch.tensor([0, *[7] * 1100, 19])
    assert_agrees(
        "surface", {"depth": torch.rand(4, 5) + 0.5}, function="known_depth", backend=backend, alpha=torch.ones(4, 5),
        rows=at // 5, columns=at % 5, known=torch.rand(len(at)) + 1, shares=None, weight=None, most=1100,
        least_alpha=LEAST_ALPHA, extent=0.5, squared=True,
    )  # fmt: skip


@pytest.mark.parametrize("backend", [GPU])
def test_how_many_samples_a_pixel_has_must_be_known(backend: str) -> None:
    depth, at = torch.ones(2, 2), torch.zeros(1, dtype=torch.int64)
    with pytest.raises(ValueError, match="surface most: expected the number of samples in a pixel, found None"):
        load("surface", backend, function="known_depth")(
            depth, depth, at, at, torch.ones(1), None, None, most=None, least_alpha=0.1, extent=None, squared=False
        )


@every
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


@every
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
    with pytest.raises(ValueError, match="surface alpha: expected torch.float64 on cpu like depth, found"):
        load("surface", "cpu")(torch.ones(2, 2).double(), torch.ones(2, 2), LEAST_ALPHA)
    with pytest.raises(ValueError, match=r"surface: expected images of \(2, 3\) pixels, found \(3, 2\)"):
        load("surface", "cpu")(torch.ones(2, 3), torch.ones(3, 2), LEAST_ALPHA)


@pytest.mark.parametrize(("row", "column"), [(2, 0), (0, 3), (-1, 0), (0, -1)])
def test_samples_outside_the_picture_are_refused_instead_of_read(row: int, column: int) -> None:
    depth, known = torch.ones(2, 3), torch.ones(2)
    at = torch.tensor([0, row]), torch.tensor([0, column])
    options = {"most": 1, "least_alpha": LEAST_ALPHA, "extent": None, "squared": False}
    with pytest.raises(IndexError, match=r"surface: 1 samples of known depth outside \(2, 3\) pixels"):
        load("surface", "cpu", function="known_depth")(depth, depth, *at, known, None, None, **options)
