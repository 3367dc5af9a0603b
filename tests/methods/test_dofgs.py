"""DOF-GS: learned lenses, and a loss where the view is in focus."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from blur_cases import (
    CAMERA,
    RANGE,
    one_gaussian,
    shot,
    trained,
)
from small_scene import cameras
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE

from dofbench.core.lens import PhysicalLens
from dofbench.methods.dofgs.method import DOFGS, FocusedBlur, FocusOptions, LocalisedBlur
from dofbench.runtime.raster import Raster
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import BlurOptions, SharpView


def test_dof_gs_learns_lenses_and_refocuses() -> None:
    method = trained(DOFGS)
    lenses = method.lens_estimates()
    assert set(lenses) == {"v0", "v1", "v2"}
    stages = method._trainer.stages
    assert stages["lens"] > 0
    wide = PhysicalLens(30.0, 1 / 6, 48)
    assert not np.array_equal(method.render(cameras()[0], wide).image, method.render(cameras()[0], None).image)


def test_the_sharp_view_is_compared_where_the_photograph_is_in_focus() -> None:
    """Focused at z = 4: the circle of what lies there is 0. Elsewhere nothing is drawn."""
    scene = one_gaussian(4.0)
    raster = scene.rasterise(CAMERA, "depth")
    image = torch.full((36, 48, 3), 0.25)
    view = ScaledView(0, "v", CAMERA, image, None, None)
    focus = float(RANGE.normalise(torch.tensor(0.25)))
    model = FocusedBlur(BlurOptions(), FocusOptions(in_focus_weight=3.0, in_focus_circle=0.5))
    cost = model.cost(SharpView(lambda: raster), shot(0, 2.0, -2.0 * focus), view)
    drawn = raster.alpha.detach() > 0
    difference = (raster.color.detach() - 0.25).abs().mean(dim=2)
    assert float(cost.detach()) == pytest.approx(
        3 * float((difference * drawn).sum().detach()) / (36 * 48), rel=FLOAT32_VALUE
    )
    assert 0 < int(drawn.sum()) < drawn.numel()
    # Focused elsewhere nothing is compared, held-back pixels never.
    assert model.cost(SharpView(lambda: raster), shot(0, 2.0, -2.0 * (focus + 0.5)), view) == 0
    kept = ScaledView(0, "v", CAMERA, image, None, torch.ones(36, 48, dtype=torch.bool))
    assert float(model.cost(SharpView(lambda: raster), shot(0, 2.0, -2.0 * focus), kept).detach()) == 0


def localising(**options) -> LocalisedBlur:
    chosen = FocusOptions(focus_network=True, **options)
    return LocalisedBlur(BlurOptions(), chosen, torch.Generator().manual_seed(0), torch.device("cpu"))


def test_the_network_says_how_much_a_pixel_is_compared() -> None:
    """With a mask of 3/4 everywhere, the sharp view's difference counts 3/4 in all that is drawn, whatever the
    circles."""
    scene, model = one_gaussian(4.0), localising(in_focus_weight=3.0)
    raster = scene.rasterise(CAMERA, "depth")
    sharp, image = SharpView(lambda: raster), torch.full((36, 48, 3), 0.25)
    view = ScaledView(0, "v", CAMERA, image, None, None)
    with torch.no_grad():
        model._network[-1].weight.zero_()
        model._network[-1].bias.fill_(math.log(3))
    blurred = model.render(scene, sharp, shot(0, 2.0, 0.0)).detach()
    cost = float(model.cost(sharp, shot(0, 2.0, 0.0), view).detach())
    color, drawn = raster.color.detach(), raster.alpha.detach() > 0
    compared = 3 * 0.75 * float(((color - 0.25).abs().mean(dim=2) * drawn).mean())
    mixed = float((0.75 * color + 0.25 * blurred - 0.25).abs().mean())
    assert cost == pytest.approx(compared + mixed + 0.002 * 0.25, rel=FLOAT32_SCALAR)


@pytest.mark.parametrize("focused", [True, False])
def test_the_network_learns_whether_the_sharp_view_fits(focused: bool) -> None:
    """The photograph is the sharp or the blurred view; where these differ, the mask tells which."""
    scene, model = one_gaussian(6.0), localising(focus_network_lr=0.02)
    raster = Raster._make(None if output is None else output.detach() for output in scene.rasterise(CAMERA, "depth"))
    sharp, lens = SharpView(lambda: raster), shot(0, 60.0, 0.0)
    blurred = model.render(scene, sharp, lens).detach()
    view = ScaledView(0, "v", CAMERA, raster.color if focused else blurred, None, None)
    differs = (raster.color - blurred).abs().mean(dim=2) > 0.05
    assert int(differs.sum()) > 50
    for _ in range(30):
        model.render(scene, sharp, lens)
        model.cost(sharp, lens, view).backward()
        model.step(0, 0.0, 1.0)
    model.render(scene, sharp, lens)
    mask = float(model.mask(sharp, lens, view).detach()[differs].mean())
    assert mask > 0.9 if focused else mask < 0.1


def test_held_out_pixels_do_not_reach_the_network() -> None:
    scene, model = one_gaussian(4.0), localising()
    raster, lens = scene.rasterise(CAMERA, "depth"), shot(0, 2.0, 0.0)
    sharp, held = SharpView(lambda: raster), torch.zeros(36, 48, dtype=torch.bool)
    held[10:20, 10:20] = True
    images = [torch.full((36, 48, 3), 0.25), torch.full((36, 48, 3), 0.25)]
    images[1][held] = 0.75
    model.render(scene, sharp, lens)
    masks = [model.mask(sharp, lens, ScaledView(0, "v", CAMERA, image, None, held)) for image in images]
    assert torch.equal(*masks)
    seen = model.mask(sharp, lens, ScaledView(0, "v", CAMERA, images[1], None, None))
    assert not torch.equal(seen, masks[1])


def test_dof_gs_trains_with_the_network() -> None:
    method = trained(DOFGS, focus_network=True)
    assert isinstance(method._trainer.state.forward.models[0], LocalisedBlur)
    assert method._trainer.stages["lens"] > 0 and set(method.lens_estimates()) == {"v0", "v1", "v2"}
