"""gsplat's deblurring example: a mask between the blurred and the sharp view."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from blur_cases import (
    CAMERA,
    enlarging,
    masked,
    one_gaussian,
    shot,
    with_outputs,
)
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import SharpView


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_a_mask_mixes_the_blurred_and_the_sharp_view(share: float) -> None:
    scene, blur = one_gaussian(3.0), masked(mask_cost=2.0)
    with_outputs(blur._enlarged, 11.0, 0.0)
    with torch.no_grad():
        blur._network.head.weight.zero_()
        blur._network.head.bias.fill_(
            math.log(share / (1 - share)) if 0 < share < 1 else math.copysign(99, share - 0.5)
        )
    raster = scene.rasterise(CAMERA, "depth")
    image = blur.render(scene, SharpView(lambda: raster), shot())
    wide = one_gaussian(3.3).rasterise(CAMERA, "none").color
    expected = share * wide + (1 - share) * raster.color
    np.testing.assert_allclose(image.detach().numpy(), expected.detach().numpy(), atol=FLOAT32_VALUE)
    view = ScaledView(0, "v", CAMERA, torch.zeros(36, 48, 3), None, None)
    cost = blur.cost(SharpView(lambda: raster), shot(), view)
    assert float(cost.detach()) == pytest.approx(2 * share, rel=FLOAT32_SCALAR)


def test_a_mask_depends_on_photograph_depth_and_place() -> None:
    blur = masked()

    def mask(number: int, z: float) -> np.ndarray:
        raster = one_gaussian(30.0, z).rasterise(CAMERA, "depth")
        return blur.mask(SharpView(lambda: raster), shot(number)).detach().numpy()

    first = mask(0, 4.0)
    assert first.shape == (36, 48) and 0 < first.min() < first.max() < 1
    assert not np.allclose(first, mask(1, 4.0)) and not np.allclose(first, mask(0, 2.0))


def test_both_networks_of_a_mask_learn() -> None:
    scene, blur = one_gaussian(3.0), masked()
    with_outputs(blur._enlarged, 5.0, 0.0)
    with torch.no_grad():
        blur._enlarged._network.head.weight.normal_(0, 1e-3, generator=torch.Generator().manual_seed(1))
    raster = scene.rasterise(CAMERA, "depth")
    before = [
        parameter.detach().clone()
        for part in (blur._network, blur._enlarged._network)
        for parameter in (part.head.weight,)
    ]
    blur.render(scene, SharpView(lambda: raster), shot()).square().sum().backward()
    assert bool(torch.isfinite(blur.gradient()).all())
    blur.step(0, 0.0, 1.0)
    after = [blur._network.head.weight, blur._enlarged._network.head.weight]
    assert not any(torch.equal(a, b) for a, b in zip(before, after, strict=True)) and blur.gradient() is None


def test_the_enlarged_gaussians_of_a_mask_learn_as_they_do_alone() -> None:
    """At the end of the training, cooled down: the rates of photograph, progress and cooldown reach them."""
    gradient = torch.Generator().manual_seed(2)
    alone, blur = enlarging(), masked()
    for network in (alone._network, blur._enlarged._network):
        gradient.manual_seed(2)
        for parameter in network.parameters():
            parameter.grad = torch.randn(parameter.shape, generator=gradient)
    for parameter in blur._network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    alone.step(2, 1.0, 0.5)
    blur.step(2, 1.0, 0.5)
    pairs = zip(alone._network.parameters(), blur._enlarged._network.parameters(), strict=True)
    assert all(torch.equal(*pair) for pair in pairs)
