"""Surfaces' disparity, circles of confusion and the error of depth by Triton against their definitions."""

from __future__ import annotations

import math
from itertools import product

import pytest
import torch
from gpu_agreement import assert_agrees

from dofbench.runtime.ops import load

LEAST_ALPHA = 0.1


@pytest.mark.parametrize("nearer", [0.0, 0.5, 9.0])
def test_disparities_agree_with_the_definition(nearer: float) -> None:
    """More pixels than one program has; with all surfaces before the camera, some, and none."""
    alpha = torch.rand(40, 37)
    depth = 2 * torch.rand(40, 37) + 0.1 - nearer
    assert_agrees("surface", {"depth": depth}, torch.randn_like(depth), alpha=alpha, least_alpha=LEAST_ALPHA)


@pytest.mark.parametrize("clipped", [(-math.inf, math.inf), (0.0, 1.0)])
def test_circles_agree_with_the_definition(clipped: tuple[float, float]) -> None:
    disparity = torch.rand(40, 37)
    disparity = torch.where(((disparity - 0.2).abs() < 0.01) | ((disparity - 0.7).abs() < 0.01), 0.3, disparity)
    inputs = {"disparity": disparity, "slope": torch.tensor(0.8), "offset": torch.tensor(-0.3)}
    numbers = {"low": 0.2, "extent": 0.5, "scale": 6.0, "clipped": clipped}
    assert_agrees("surface", inputs, torch.randn_like(disparity), function="circle", **numbers)


@pytest.mark.parametrize(
    ("shared", "weighted", "extent", "squared"),
    list(product((False, True), (False, True), (None, 0.6), (False, True))),
)
def test_errors_of_depth_agree_with_the_definition(
    shared: bool, weighted: bool, extent: float | None, squared: bool
) -> None:
    """More samples than one program has, several of them in one pixel."""
    at = torch.randint(300, (1400,)).sort().values
    samples = {"rows": at // 20, "columns": at % 20}
    given = {"known": torch.rand(len(at)) + 1, "shares": torch.rand(len(at)), "weight": torch.rand(15, 20)}
    given |= {} if shared else {"shares": None}
    given |= {} if weighted else {"weight": None}
    options = {"most": int(at.bincount().max()), "least_alpha": LEAST_ALPHA, "extent": extent, "squared": squared}
    assert_agrees(
        "surface", {"depth": torch.rand(15, 20) + 0.5}, function="known_depth",
        alpha=torch.rand(15, 20), **samples, **given, **options,
    )  # fmt: skip


def test_samples_of_a_pixel_are_added_up_over_the_border_of_programs() -> None:
    """All but the first and the last sample lie in one pixel, whose first sample adds up those of several programs."""
    at = torch.tensor([0, *[7] * 1100, 19])
    assert_agrees(
        "surface", {"depth": torch.rand(4, 5) + 0.5}, function="known_depth", alpha=torch.ones(4, 5), rows=at // 5,
        columns=at % 5, known=torch.rand(len(at)) + 1, shares=None, weight=None, most=1100, least_alpha=LEAST_ALPHA,
        extent=0.5, squared=True,
    )  # fmt: skip


def test_how_many_samples_a_pixel_has_must_be_known() -> None:
    depth, at = torch.ones(2, 2), torch.zeros(1, dtype=torch.int64)
    with pytest.raises(ValueError, match="surface: expected to be told how many samples a pixel has at most, found No"):
        load("surface", "gpu", function="known_depth")(
            depth, depth, at, at, torch.ones(1), None, None, most=None, least_alpha=0.1, extent=None, squared=False
        )


def test_pixels_without_a_surface_have_no_gradient_whatever_comes_from_behind() -> None:
    depth = torch.tensor([[2.0, math.nan, 3.0, -1.0]], requires_grad=True)
    found = load("surface", "gpu")(depth, torch.tensor([[1.0, 1.0, 0.05, 1.0]]), LEAST_ALPHA)
    assert found.tolist() == [[0.5, 0.5, 0.5, 0.5]]
    found.backward(torch.tensor([[1.0, math.nan, math.inf, math.nan]]))
    assert depth.grad is not None and depth.grad.tolist() == [[-0.25, 0.0, 0.0, 0.0]]
