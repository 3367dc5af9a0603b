"""`mix` by Triton against its definition."""

from __future__ import annotations

import pytest
import torch
from gpu_agreement import assert_agrees

from dofbench.runtime.ops import load


@pytest.mark.parametrize(("height", "width", "channels", "size"), [(7, 21, 3, 3), (3, 4, 5, 5), (1, 1, 1, 3)])
def test_it_agrees_with_the_definition(height: int, width: int, channels: int, size: int) -> None:
    image = torch.rand(height, width, channels)
    inputs = {"image": image, "logits": 3 * torch.randn(height, width, size * size)}
    assert_agrees("mix", inputs, torch.randn_like(image))


def test_large_logits_do_not_overflow() -> None:
    logits = torch.full((2, 3, 9), -500.0)
    logits[..., 4] = 500.0
    image = torch.rand(2, 3, 3)
    assert torch.equal(load("mix", "gpu")(image, logits), image)


def test_a_logit_that_is_not_a_number_is_found_in_its_pixel_alone() -> None:
    logits = torch.randn(3, 4, 9)
    logits[1, 2, 5] = torch.nan
    found = load("mix", "gpu")(torch.rand(3, 4, 3), logits).isnan().all(2)
    assert found[1, 2] and found.sum() == 1
