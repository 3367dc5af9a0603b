"""BAGS: proposed kernels, their mask, and three scales."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from blur_cases import (
    CAMERA,
    one_gaussian,
    proposing,
    shot,
)
from small_scene import training_set
from tolerances import FLOAT32_VALUE

from dofbench.core.errors import InputError
from dofbench.methods.bags.method import ProposedBlur, ProposedOptions, ThreeScales, variation
from dofbench.training.common.monitor import StageClock
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import SharpView
from dofbench.training.gaussians.training_state import TrainingState
from dofbench.training.gaussians.training_step import take_step


def fixed(blur: ProposedBlur, logit: float, neighbour: int, mask: float) -> ProposedBlur:
    """The network gives this neighbour a weight of its own, and this mask's logit, everywhere: its last features are
    made constant."""
    network = blur._network
    with torch.no_grad():
        network.base.weight.zero_()
        network.photograph.weight.zero_()
        network.photograph.weight[0] = 1.0
        network.embedding.fill_(1 / 32)  # so the first feature is 1, and the others are 0
        for layer in network.deeper:
            layer.weight.copy_(torch.eye(64))
        for head in network.heads.values():
            head.weight.zero_()
            head.weight[neighbour, 0], head.weight[-1, 0] = logit, mask
    return blur


@pytest.mark.parametrize(("width", "size"), [(48, 17), (96, 9), (192, 5), (150, 5), (1000, 5)])
def test_the_kernel_is_as_large_as_the_scale_asks(width: int, size: int) -> None:
    """A picture 48 px wide of photographs of other widths: all weight on the first neighbour moves it by half a
    kernel."""
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    blur = fixed(proposing(width), 300.0, 0, 300.0)
    found = blur.render(scene, SharpView(lambda: raster), shot()).detach().numpy()
    half = size // 2
    expected = np.zeros_like(found)
    expected[half:, half:] = raster.color.detach().numpy()[:-half, :-half]
    np.testing.assert_allclose(found, expected, atol=FLOAT32_VALUE)


def test_a_proposal_is_mixed_by_its_mask_and_charged_for_it() -> None:
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    blur = fixed(proposing(192, proposal_cost=3.0), 300.0, 0, math.log(0.25 / 0.75))
    found = blur.render(scene, SharpView(lambda: raster), shot()).detach().numpy()
    sharp = raster.color.detach().numpy()
    moved = np.zeros_like(sharp)
    moved[2:, 2:] = sharp[:-2, :-2]
    np.testing.assert_allclose(found, 0.25 * moved + 0.75 * sharp, atol=FLOAT32_VALUE)
    view = ScaledView(0, "v", CAMERA, torch.zeros(36, 48, 3), None, None)
    cost = blur.cost(SharpView(lambda: raster), shot(), view)
    assert float(cost.detach()) == pytest.approx(3 * 0.25, rel=FLOAT32_VALUE)


def test_the_network_of_proposals_learns_from_the_picture_and_tells_photographs_apart() -> None:
    scene, blur = one_gaussian(4.0), proposing(96)
    raster = scene.rasterise(CAMERA, "depth")
    pictures = [blur.render(scene, SharpView(lambda: raster), shot(number)) for number in (0, 1)]
    assert not torch.equal(*pictures)
    pictures[1].square().sum().backward()
    assert bool(torch.isfinite(blur.gradient()).all()) and float(blur.gradient().abs().sum()) > 0
    before = blur._network.heads["2"].weight.detach().clone()
    blur.step(1, 0.0, 1.0)
    assert not torch.equal(blur._network.heads["2"].weight, before) and blur.gradient() is None


def test_the_variation_of_a_ramp_is_that_of_its_steps() -> None:
    """Twice the mean squared steps down and across, here 3 and 1 in one channel of two."""
    rows, columns = torch.meshgrid(torch.arange(4.0), torch.arange(5.0), indexing="ij")
    image = torch.stack([3 * rows + columns, torch.zeros_like(rows)], 2)
    assert float(variation(image)) == pytest.approx(2 * (9 + 1) / 2)


@pytest.mark.parametrize(
    ("option", "shown"),
    [("colour_variation", lambda raster: raster.color), ("depth_variation", lambda raster: scaled(raster.depth))],
)
def test_a_varying_view_is_charged_for_it(option: str, shown) -> None:
    """On top of the mask's cost, with a gradient to what varies."""
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    view = ScaledView(0, "v", CAMERA, torch.zeros(36, 48, 3), None, None)
    costs = []
    for weight in (0.0, 3.0):
        blur = fixed(proposing(192, **{option: weight}), 0.0, 0, 0.0)
        blur.render(scene, SharpView(lambda: raster), shot())
        costs.append(blur.cost(SharpView(lambda: raster), shot(), view))
    expected = float(variation(shown(raster)).detach())
    assert expected > 0
    assert float((costs[1] - costs[0]).detach()) == pytest.approx(3 * expected, rel=FLOAT32_VALUE)


def scaled(depth: torch.Tensor) -> torch.Tensor:
    return ((depth - depth.min()) / (depth.max() - depth.min()))[..., None]


def test_the_rate_of_the_means_begins_again() -> None:
    """As of the last scale at 0.4: its share of the fall is then over what is left."""
    options = {"restart_at": 0.4, "means_lr": 1e-2, "means_lr_final": 1e-4, "coarse_until": 0.0, "quarter_until": 0.0}
    state = TrainingState(training_set(), ProposedOptions().with_overrides({**options, "lens": False}), 0)
    view = ScaledView(0, "v0", state.cameras[0], torch.from_numpy(training_set().views[0].image), None, None)
    rates = []
    for step, progress in enumerate((0.0, 0.2, 0.4, 0.7, 1.0), 1):
        take_step(state, step, progress, view, StageClock())
        rates.append(state.optimiser.means_rate)
    expected = [1.0, 0.01**0.2, 1.0, 0.1, 0.01]
    assert [rate / rates[0] for rate in rates] == pytest.approx(expected)


@pytest.mark.parametrize("options", [{"restart_at": 1.0}, {"depth_variation": -1.0}, {"colour_variation": -1.0}])
def test_parts_of_bags_have_their_bounds(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=f"^option {next(iter(options))}: "):
        ProposedOptions().with_overrides(options)


def test_three_scales() -> None:
    scales = ThreeScales()
    assert [scales.size(progress) for progress in (0.0, 0.0999, 0.1, 0.1999, 0.2, 1.0)] == [4, 4, 2, 2, 1, 1]
    assert scales.sizes == (1, 2, 4)
    assert ThreeScales(quarter_until=0.0).sizes == (1, 2) and ThreeScales(quarter_until=0.2).sizes == (1, 4)


@pytest.mark.parametrize(("width", "deeper"), [(192, 0), (96, 1), (48, 2)])
def test_each_finer_scale_has_a_layer_more(width: int, deeper: int) -> None:
    """A picture of a quarter, of half and of all of the photographs' size: the coarse scales come first."""
    scene, blur = one_gaussian(4.0), proposing(width)
    raster = scene.rasterise(CAMERA, "depth")
    blur.render(scene, SharpView(lambda: raster), shot()).square().sum().backward()
    sizes = {factor: head.weight.grad is not None for factor, head in blur._network.heads.items()}
    assert sum(sizes.values()) == 1
    learned = [layer.weight.grad is not None and bool(layer.weight.grad.any()) for layer in blur._network.deeper]
    assert learned == [index < deeper for index in range(len(learned))]
