"""CoCoGaussian: copies of each Gaussian on its circle of confusion."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from blur_cases import (
    CAMERA,
    copying,
    no_view,
    one_gaussian,
    shot,
)
from made_up import cloud, frontal
from tolerances import ADAM_FIRST_STEP, FLOAT32_GRADIENT, FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.methods.cocogaussian.method import CircleCopies, CopiedOptions, CopiesOptions, mixing_network
from dofbench.training.gaussians.forward_model import BlurStart
from dofbench.training.gaussians.model import Gaussians


def test_what_is_in_focus_is_not_copied_elsewhere() -> None:
    """At the focused distance, on the axis, the circle is 0: all copies are the scene itself."""
    scene = one_gaussian(2.0)
    blur = copying(4.0)
    copies = blur.copies(scene.gaussians.parameters, shot())
    assert len(copies) == 5 and "means" not in copies[0]
    for changes in copies:
        for name, value in changes.items():
            difference = (value - scene.gaussians.parameters[name])[0].abs().max()
            assert float(difference.detach()) < FLOAT32_SCALAR, name
    elsewhere = copying(8.0).copies(scene.gaussians.parameters, shot())
    moved = (elsewhere[1]["means"] - scene.gaussians.parameters["means"]).detach()
    assert float(moved[0].abs().max()) > 0.001


def test_a_copy_moves_and_grows_by_the_published_formulae() -> None:
    """d = |1/4 - 1/8| times the unit of 2: moves of 2 d o, factors log(clamp(d o + e - 0.01, e, e^1.1))."""
    scene, blur = one_gaussian(2.0), copying(8.0)
    with torch.no_grad():
        blur._network.head.weight.zero_()
        blur._network.head.bias[:12], blur._network.head.bias[12:] = 0.5, 0.4
    copies = blur.copies(scene.gaussians.parameters, shot())
    circle = 2 * (1 / 4 - 1 / 8)
    moved = (copies[3]["means"] - scene.gaussians.parameters["means"]).detach()[0]
    assert moved.tolist() == pytest.approx([2 * circle * 0.5] * 3, rel=FLOAT32_GRADIENT)
    factor = math.log(min(max(circle * 0.4 + math.e - 0.01, math.e), math.e**1.1))
    grown = (copies[0]["log_scales"] - scene.gaussians.parameters["log_scales"]).detach()[0].exp()
    assert grown.tolist() == pytest.approx([factor] * 3, rel=FLOAT32_GRADIENT)
    assert copies[2]["quaternions"][0].tolist() == pytest.approx([factor, 0, 0, 0], rel=FLOAT32_GRADIENT)


def test_copies_are_mixed_evenly_at_first() -> None:
    scene, blur = one_gaussian(2.0), copying(8.0, copies=2)
    views = [scene.rasterise_with(CAMERA, changes) for changes in blur.copies(scene.gaussians.parameters, shot())]
    expected = torch.stack(views).mean(dim=0).detach()
    found = blur.render(scene, no_view(), shot()).detach()
    np.testing.assert_allclose(found.numpy(), expected.numpy(), atol=FLOAT32_VALUE)


def test_each_view_gets_its_weight_by_itself() -> None:
    """The published mixing: views in another order have their weights in that order, and equal views equal ones."""
    network = mixing_network(CopiesOptions(copies=2, mixing="each"), torch.Generator().manual_seed(0))
    views = torch.rand(3, 3, 12, 16, generator=torch.Generator().manual_seed(1))
    views[2] = views[0]
    logits, moved = network(views), network(views[[1, 0, 2]])
    assert logits.shape == (3, 1, 12, 16)
    torch.testing.assert_close(moved, logits[[1, 0, 2]], atol=FLOAT32_VALUE, rtol=FLOAT32_VALUE)
    torch.testing.assert_close(logits[2], logits[0], atol=FLOAT32_VALUE, rtol=FLOAT32_VALUE)
    assert float((logits[1] - logits[0]).abs().max().detach()) > 0.01


def test_a_mixture_by_single_views_is_a_mean_of_them_and_learns() -> None:
    """Weights are at least 0 with sum 1: the mixture lies between the darkest and the brightest view of a pixel."""
    scene, blur = one_gaussian(2.0), copying(8.0, mixing="each")
    views = [scene.rasterise_with(CAMERA, changes) for changes in blur.copies(scene.gaussians.parameters, shot())]
    stacked = torch.stack(views).detach()
    found = blur.render(scene, no_view(), shot())
    assert bool((found >= stacked.amin(0) - FLOAT32_VALUE).all() and (found <= stacked.amax(0) + FLOAT32_VALUE).all())
    found.square().sum().backward()
    weight = blur._mixing[0].weight
    assert float(weight.grad.abs().sum()) > 0
    before = weight.detach().clone()
    blur.step(0, 0.0, 1.0)
    assert not torch.equal(weight, before)


def test_focus_and_networks_of_copies_learn() -> None:
    scene, blur = one_gaussian(2.0), copying(8.0, focus_lr=0.1)
    blur.render(scene, no_view(), shot(1)).square().sum().backward()
    assert bool(torch.isfinite(blur.gradient()).all())
    blur.step(1, 0.0, 1.0)
    found = blur.focuses()
    assert float(found[0]) == 8.0 and abs(math.log(float(found[1]) / 8.0)) == pytest.approx(0.1, rel=FLOAT32_VALUE)
    assert [start for start, _ in blur.models()] == [0.0, 0.05]


def test_the_rate_of_copies_falls_and_is_cooled_down() -> None:
    """Adam's first step is as long as its rate: a hundredth of the first at the end, and half of that cooled down."""
    scene, blur = one_gaussian(2.0), copying(8.0, focus_lr=0.1, copies_lr=0.02)
    with torch.no_grad():
        blur._network.head.weight.normal_(0, 1e-2, generator=torch.Generator().manual_seed(1))
    blur.render(scene, no_view(), shot(1)).square().sum().backward()
    before = blur._network.head.bias.detach().clone()
    blur.step(1, 1.0, 0.5)
    change = (blur._network.head.bias.detach() - before).abs().max()
    assert float(change) == pytest.approx(0.02 / 100 / 2, rel=ADAM_FIRST_STEP)
    assert abs(math.log(float(blur.focuses()[1]) / 8.0)) == pytest.approx(0.05, rel=FLOAT32_VALUE)


def test_photographs_begin_to_be_focused_at_the_mean_distance_of_the_gaussians() -> None:
    gaussians = Gaussians.from_points(cloud([(0, 0, 3.0), (0, 4, 0.0), (0, 0, 13.0), (12, 0, 5.0)]), 0)
    cameras = [frontal(8, 6, 8.0), frontal(8, 6, 8.0, (12.0, 0.0, 0.0))]
    blur = CopiedOptions().learned_blur(BlurStart(gaussians, cameras, 1.0, torch.Generator().manual_seed(0)))
    places = gaussians.parameters["means"].detach().double().numpy()
    expected = [np.linalg.norm(places - camera.centre, axis=1).mean() for camera in cameras]
    assert isinstance(blur, CircleCopies)
    assert blur.focuses().tolist() == pytest.approx(expected, rel=FLOAT32_VALUE)
