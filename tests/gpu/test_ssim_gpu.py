"""SSIM and the colour loss by Triton against their definitions."""

from __future__ import annotations

import pytest
import torch
from gpu_agreement import assert_agrees, called, distance
from tolerances import FLOAT32_GRADIENT, SSIM_NEAR_ONE

from dofbench.runtime.ops import load


def pair(height: int, width: int, channels: int = 3, noise: float = 0.1) -> tuple[torch.Tensor, torch.Tensor]:
    """(prediction, target), with a flat patch that is equal in both."""
    target = torch.rand(height, width, channels)
    prediction = target + noise * torch.randn_like(target)
    prediction[: height // 3, : width // 3] = target[: height // 3, : width // 3] = 0.9
    return prediction, target


@pytest.mark.parametrize("border", ["same", "valid"])
def test_ssim_agrees_with_the_definition(border: str) -> None:
    prediction, target = pair(11, 90)  # two blocks across
    assert_agrees("ssim", {"prediction": prediction}, target=target, border=border)


@pytest.mark.parametrize(
    "options",
    [{}, {"edge_weight": 2.0}, {"weigh_all": True, "edge_weight": 0.5}, {"border": "valid", "weigh_all": True}],
)
def test_the_loss_agrees_with_the_definition(options: dict) -> None:
    prediction, target = pair(12, 15)
    weight = torch.rand(12, 15)
    assert_agrees(
        "ssim", {"prediction": prediction}, target=target, function="l1_ssim", ssim_weight=0.3, weight=weight, **options
    )


@pytest.mark.parametrize("shape", [(1, 5, 1), (5, 1, 2), (1, 1, 3)])
def test_images_of_one_row_or_column(shape: tuple[int, int, int]) -> None:
    prediction, target = (torch.rand(shape) for _ in range(2))
    options = {"ssim_weight": 0.3, "edge_weight": 1.0, "data_range": 2.0, "window": 5, "sigma": 1.0}
    assert_agrees("ssim", {"prediction": prediction}, target=target, function="l1_ssim", **options)


def test_close_to_convergence_no_digits_are_lost() -> None:
    prediction, target = pair(14, 14, noise=1e-3)
    found, gradients = called(
        load("ssim", "gpu", function="l1_ssim"), {"p": prediction}, None, target=target, ssim_weight=1.0
    )
    exact = {"p": prediction.double()}
    reference = load("ssim", "reference", function="l1_ssim")
    expected, expected_gradients = called(reference, exact, None, target=target.double(), ssim_weight=1.0)
    assert distance(found, expected) < SSIM_NEAR_ONE
    assert distance(gradients["p"], expected_gradients["p"]) < FLOAT32_GRADIENT


def test_nan_makes_the_result_nan() -> None:
    prediction, target = pair(5, 6)
    prediction[2, 3, 1] = torch.nan
    assert load("ssim", "gpu")(prediction, target).isnan()
