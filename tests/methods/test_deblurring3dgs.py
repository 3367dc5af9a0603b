"""Deblurring-3DGS's network: what it enlarges, and what it learns."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from blur_cases import (
    CAMERA,
    RANGE,
    enlarging,
    no_view,
    one_gaussian,
    shot,
    with_outputs,
)
from made_up import frontal
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.training.gaussians.blur_network import GaussianNetwork
from dofbench.training.gaussians.forward_model import Shot


@pytest.mark.parametrize(("output", "factor"), [(0.0, 1.0), (-50.0, 1.0), (3.0, 1.02), (11.0, 1.1), (50.0, 1.1)])
def test_scales_grow_by_the_published_factor(output: float, factor: float) -> None:
    """clamp(0.01 o + 0.99, 1, 1.1)."""
    scene = one_gaussian(2.0)
    blur = with_outputs(enlarging(), output, 0.0)
    found = blur.enlarged(scene.gaussians.parameters, shot())["log_scales"] - scene.gaussians.parameters["log_scales"]
    assert found.detach().exp().unique().tolist() == pytest.approx([factor], rel=FLOAT32_SCALAR)
    image = blur.render(scene, no_view(), shot())
    expected = one_gaussian(2.0 * factor).rasterise(CAMERA, "none").color
    np.testing.assert_allclose(image.detach().numpy(), expected.detach().numpy(), atol=FLOAT32_VALUE)


def test_quaternions_change_by_component() -> None:
    scene = one_gaussian(2.0)
    with torch.no_grad():
        scene.gaussians.parameters["quaternions"][:] = torch.tensor([0.5, -0.5, 0.5, 0.5])
    blur = with_outputs(enlarging(), 0.0, 0.0)
    with torch.no_grad():
        blur._network.head.bias[3:] = torch.tensor([0.0, 11.0, 3.0, 99.0])
    found = blur.enlarged(scene.gaussians.parameters, shot())["quaternions"]
    assert found[0].tolist() == pytest.approx([0.5, -0.55, 0.51, 0.55], rel=FLOAT32_SCALAR)


def test_the_network_learns_and_what_it_sees_does_not() -> None:
    """Places, scales and rotations reach the network detached: a Gaussian learns by its picture alone."""
    scene = one_gaussian(2.0)
    blur = with_outputs(enlarging(), 5.0, 0.0)
    head = blur._network.head
    with torch.no_grad():
        head.weight.normal_(0, 1e-3, generator=torch.Generator().manual_seed(1))
    changed = blur.enlarged(scene.gaussians.parameters, shot())
    changed["log_scales"].sum().backward()
    assert float(blur.gradient().abs().sum()) > 0
    assert scene.gaussians.parameters["log_scales"].grad.unique().tolist() == [1.0]
    assert scene.gaussians.parameters["means"].grad is None
    before = head.weight.detach().clone()
    blur.step(0, 0.0, 1.0)
    assert not torch.equal(head.weight, before) and blur.gradient() is None


def test_the_network_tells_gaussians_and_cameras_apart() -> None:
    scene = one_gaussian(2.0)
    blur = enlarging(enlarge_lambda=1.0, enlarge_most=100.0)
    with torch.no_grad():
        blur._network.head.bias.fill_(50.0)
    here = blur.enlarged(scene.gaussians.parameters, shot())["log_scales"]
    there = Shot(frontal(48, 36, 45.0, (0.3, 0.0, 0.0)), RANGE, 0.0, 0.0, number=1)
    assert not torch.equal(here, blur.enlarged(scene.gaussians.parameters, there)["log_scales"])
    grown = here - scene.gaussians.parameters["log_scales"]
    assert len(grown.unique(dim=0)) > 1


def test_the_network_may_begin_later() -> None:
    assert [start for start, _ in enlarging(enlarge_from=0.2).models()] == [0.0, 0.2]
    assert [start for start, _ in enlarging().models()] == [0.0]


def test_every_part_of_the_network_learns() -> None:
    network = GaussianNetwork((2,), (1.0,), torch.zeros(3), 1.0, torch.Generator().manual_seed(0))
    names = dict(network.named_parameters())
    # The camera's part of the first layer has no bias of its own.
    hidden = [name for name in names if name.startswith("hidden")]
    assert set(names) == {"first.weight", "first.bias", "camera.weight", "head.weight", "head.bias", *hidden}
    (found,) = network(one_gaussian(2.0).gaussians.parameters, CAMERA)
    found.square().sum().backward()
    assert all(float(one.grad.abs().max()) > 0 for one in names.values())
