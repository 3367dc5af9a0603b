"""The scatter by Triton against its definition."""

from __future__ import annotations

import math

import pytest
import torch
from gpu_agreement import assert_agrees
from tolerances import HIGHLIGHT

from dofbench.core.lens import ApertureShape
from dofbench.kernels import load

SHAPES = {
    "disc": ApertureShape(),
    "hexagon": ApertureShape(blades=6, rotation=0.3, curvature=0.2),
    "donut": ApertureShape(obstruction=0.5),
    "stopped-pentagon": ApertureShape(blades=5, rotation=0.1, obstruction=0.3),
}


def scene(height: int, width: int, largest: float, channels: int = 3) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Random image and signed radius, the arguments of a call; and a gradient of its result."""
    image = torch.rand(height, width, channels)
    return {"image": image, "signed_radius": (torch.rand(height, width) * 2 - 1) * largest}, torch.randn_like(image)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_it_agrees_with_the_definition(shape: ApertureShape) -> None:
    inputs, upstream = scene(9, 34, 1.5)  # two tiles down and across
    inputs["signed_radius"][0, :3] = 0.0
    assert_agrees("scatter", inputs, upstream, shape=shape)


def test_without_the_area_term_of_other_channels_and_another_edge() -> None:
    inputs, upstream = scene(5, 9, 2.0, channels=4)
    assert_agrees("scatter", inputs, upstream, energy="algorithm1", alpha=2.0)


def test_a_circle_reaches_over_tiles_that_are_sharp_themselves() -> None:
    inputs, upstream = scene(1, 66, 0.2)
    inputs["signed_radius"][0, 31] = 35.0  # the third tile is out of reach of its neighbours' circles, not of this one
    assert_agrees("scatter", inputs, upstream)


def test_beside_a_highlight_every_pixel_is_right() -> None:
    inputs, _ = scene(5, 20, 1.5)
    inputs["image"][2, 10] = 1e6
    found, expected = (
        load("scatter", name)(*(value.to(kind) for value in inputs.values()))
        for name, kind in (("gpu", torch.float32), ("reference", torch.float64))
    )
    assert ((found - expected).abs() / expected).max() < HIGHLIGHT


@pytest.mark.parametrize("radius", [math.nan, math.inf, 1e19])
def test_a_radius_without_a_meaning_is_found_in_the_picture(radius: float) -> None:
    inputs, _ = scene(4, 6, 1.0)
    inputs["signed_radius"][2, 3] = radius
    assert load("scatter", "gpu")(*inputs.values())[2, 3].isnan().all()


def test_the_same_bits_twice() -> None:
    inputs, _ = scene(4, 6, 2.0)
    assert torch.equal(*(load("scatter", "gpu")(*inputs.values()) for _ in range(2)))
