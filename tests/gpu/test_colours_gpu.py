"""The colour transform by Triton against its definition."""

from __future__ import annotations

import pytest
import torch
from gpu_agreement import assert_agrees

from dofbench.runtime.ops import load


@pytest.mark.parametrize(("height", "width"), [(30, 37), (1, 1)])
def test_it_agrees_with_the_definition(height: int, width: int) -> None:
    """More pixels than one program has, and one."""
    image = torch.rand(height, width, 3)
    assert_agrees("colours", {"image": image, "change": torch.rand(3, 4) - 0.5}, torch.randn_like(image))


def test_a_channel_that_is_not_a_number_is_found_in_its_pixel_alone() -> None:
    image = torch.rand(3, 4, 3)
    image[1, 2, 0] = torch.nan
    found = load("colours", "gpu")(image, torch.rand(3, 4)).isnan().any(2)
    assert found[1, 2] and found.sum() == 1
