"""The scatter by Triton against its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from gpu_agreement import assert_agrees
from tolerances import FLOAT32_VALUE, HIGHLIGHT

from dofbench.core.lens import ApertureShape
from dofbench.runtime.gpu_launch import kernels, launch
from dofbench.runtime.ops import load
from dofbench.runtime.ops.scatter import gpu as scatter_gpu

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


@pytest.mark.parametrize("bad", [None, math.nan, math.inf])
@pytest.mark.parametrize("highlights", [0, 5])
def test_how_bright_a_picture_is(highlights: int, bad: float | None) -> None:
    """Of several blocks, the last one cut: the mean is without what is above 4 e times the mean of all."""
    image, radius = torch.rand(37, 41, 3) - 0.5, torch.rand(37, 41) * 2 - 1
    image.view(-1)[:: image.numel() // 5][:highlights] = -6.0
    radius[30, 2], radius[3, 3] = -7.5, math.nan
    values = image.abs().double().numpy()
    expected = [values.max(), values[values <= 4 * math.e * values.mean()].mean(), 7.5]
    if bad is not None:
        image[36, 40, 2] = bad
        expected[:2] = 1.0, 1.0
    size, block = radius.numel(), scatter_gpu._BLOCK
    planes, sums = torch.empty(5, 37, 41), torch.full((5, -(-size // block)), math.nan)
    assert sums.shape[1] > 2 and size % block
    pack = kernels("scatter.gpu_direct").pack_sources
    launch(pack, sums.shape[1:], image, radius, planes, sums, size, 1e18, AREA=True, BLOCK=block)
    np.testing.assert_allclose(scatter_gpu._brightness(image, sums).numpy(), expected, rtol=FLOAT32_VALUE)


@pytest.mark.parametrize("radius", [math.nan, math.inf, 1e19])
def test_a_radius_without_a_meaning_is_found_in_the_picture(radius: float) -> None:
    inputs, _ = scene(4, 6, 1.0)
    inputs["signed_radius"][2, 3] = radius
    assert load("scatter", "gpu")(*inputs.values())[2, 3].isnan().all()


def test_the_same_bits_twice() -> None:
    inputs, _ = scene(4, 6, 2.0)
    assert torch.equal(*(load("scatter", "gpu")(*inputs.values()) for _ in range(2)))


def wide(height: int = 2, width: int = 36) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Circles of much the same radius, of both signs and larger than the picture: whole windows count in full."""
    inputs, upstream = scene(height, width, 1.0)
    inputs["signed_radius"] = torch.where(inputs["signed_radius"] < 0, -1, 1) * torch.linspace(19.0, 22.0, width)
    inputs["signed_radius"] = inputs["signed_radius"].expand(height, width).contiguous()
    return inputs, upstream


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_windows_that_count_in_full_are_added_as_a_sum(shape: ApertureShape) -> None:
    inputs, upstream = wide()
    assert_agrees("scatter", inputs, upstream, shape=shape, form="linear")


def test_windows_lie_where_the_aperture_points() -> None:
    """A triangle reaches twice as far to the right as to the left."""
    inputs, upstream = scene(1, 30, 1.0)
    inputs["signed_radius"] = torch.full((1, 30), 20.0)
    assert_agrees("scatter", inputs, upstream, shape=ApertureShape(blades=3), form="linear")


def test_the_linear_form_of_small_and_vanishing_circles() -> None:
    inputs, upstream = scene(3, 9, 2.5, channels=2)
    inputs["signed_radius"][1, :4] = 0.0
    assert_agrees("scatter", inputs, upstream, form="linear", energy="algorithm1", alpha=6.0)


def test_the_linear_form_across_tiles_down() -> None:
    inputs, upstream = scene(9, 3, 0.5)
    inputs["signed_radius"][4:, :] = 5.0
    assert_agrees("scatter", inputs, upstream, form="linear")


def test_each_tile_has_its_form() -> None:
    """The first tile is out of reach of the last columns' circles and has the direct form, the others the linear."""
    inputs, upstream = scene(1, 99, 0.2)
    inputs["signed_radius"][0, 65:] = 30.0
    assert_agrees("scatter", inputs, upstream)


@pytest.mark.parametrize("form", ["direct", "linear"])
def test_a_highlight_among_wide_circles_drowns_nothing(form: str) -> None:
    inputs, _ = wide(2, 34)
    inputs["image"] += 0.1
    inputs["image"][1, 10] = 1e6
    inputs["signed_radius"][:, 20:] = 2.5
    found, expected = (
        load("scatter", name)(*(value.to(kind) for value in inputs.values()), form=form)
        for name, kind in (("gpu", torch.float32), ("reference", torch.float64))
    )
    assert ((found - expected).abs() / expected).max() < HIGHLIGHT


def test_a_radius_without_a_meaning_among_wide_circles() -> None:
    inputs, _ = wide(1, 12)
    inputs["signed_radius"][0, 3] = math.nan
    assert load("scatter", "gpu")(*inputs.values(), form="linear")[0, 3].isnan().all()


def test_the_linear_form_has_the_same_bits_twice() -> None:
    inputs, _ = wide(1, 20)
    assert torch.equal(*(load("scatter", "gpu")(*inputs.values(), form="linear") for _ in range(2)))
