"""What all learned blurs have in common: training with them, saved models, and renderings without."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from blur_cases import (
    BARE,
    CAMERA,
    copying,
    masked,
    no_view,
    one_gaussian,
    proposing,
    shot,
    trained,
)
from small_scene import cameras
from tolerances import FLOAT32_VALUE

from dofbench.core.lens import PhysicalLens
from dofbench.methods.bags.method import BAGS
from dofbench.methods.cocogaussian.method import CoCoGaussian
from dofbench.methods.deblurring3dgs.method import Deblurring3DGS, EnlargedGaussians, EnlargingOptions
from dofbench.methods.gsplat_deblur.method import MaskedDeblurring
from dofbench.methods.rgs.method import RobustSplatting, UniformBlur, UniformBlurOptions
from dofbench.training.gaussians.forward_model import BlurOptions, BlurStart, SharpView
from dofbench.training.gaussians.lens_models import LensSamples, OwnBlur, Pinhole, ScatterBlur, ScatterOptions
from dofbench.training.gaussians.lens_renderer import StillRasteriser
from dofbench.training.gaussians.model import PARAMETERS, Gaussians


def test_what_a_blur_begins_with_lies_where_the_gaussians_do() -> None:
    gaussians = Gaussians({name: torch.zeros(5, 3, device="meta") for name in PARAMETERS})
    start = BlurStart(gaussians, cameras(), 1.0, torch.Generator())
    assert start.means.device == torch.device("meta") and start.centre.device == start.means.device


@pytest.mark.parametrize(
    "model",
    [
        Pinhole(),
        ScatterBlur(BlurOptions(), ScatterOptions()),
        LensSamples(BlurOptions(), 1),
        OwnBlur(BlurOptions()),
        UniformBlur(2, UniformBlurOptions()),
        EnlargedGaussians(torch.zeros(3), 1.0, EnlargingOptions(), torch.Generator()),
        masked(),
        copying(),
        proposing(),
    ],
)
def test_a_model_says_what_it_needs(model, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sharp view is rasterised before the model, under its own name in the table of times; what rasterises from
    aperture samples is compiled before training."""
    scene, looked, moved = one_gaussian(3.0), [], []
    from_points = scene.rasterise_from_points
    monkeypatch.setattr(scene, "rasterise_from_points", lambda *given: moved.append(1) or from_points(*given))
    sharp = SharpView(lambda: looked.append(1) or scene.rasterise(CAMERA, "depth"))
    model.render(scene, sharp, shot(slope=0.1))
    assert (model.needs_sharp_render, model.samples_aperture) == (bool(looked), bool(moved))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RobustSplatting, Deblurring3DGS, MaskedDeblurring, CoCoGaussian, BAGS])
def test_what_is_learned_explains_the_photographs_and_is_left_out_of_renderings(kind, tmp_path) -> None:
    enlarged = {"enlarge_lambda": 1.0, "enlarge_most": 3.0}
    strong = {RobustSplatting: {"view_blur_init": 20.0}, CoCoGaussian: {}, BAGS: {}}.get(kind, enlarged)
    method = trained(kind, **strong)
    trainer = method._trainer
    sharp = method.render(cameras()[0], None).image
    assert np.abs(trainer.render_view(0) - sharp).max() > 0.01
    assert method.lens_estimates() is None
    with pytest.raises(ValueError, match="no lens"):
        method.render(cameras()[0], PhysicalLens(1.0, 0.2, 48))
    method.save(tmp_path)
    loaded = kind({}, 0, "cpu")
    loaded.load(tmp_path)
    np.testing.assert_allclose(loaded.render(cameras()[0], None).image, sharp, atol=FLOAT32_VALUE)


@pytest.mark.parametrize("kind", [RobustSplatting, Deblurring3DGS])
def test_a_snapshot_has_the_blur(kind) -> None:
    method = trained(kind, **({} if kind is RobustSplatting else {"enlarge_lambda": 0.1, "enlarge_most": 9.0}))
    state = method._trainer.state
    before, kept = method._trainer.render_view(0), state.snapshot()
    state.blur.step(0, 0.0, 1.0)
    image = state.forward.at(0.9).render(StillRasteriser(state.gaussians, BARE), no_view(), shot(0))
    (-image.sum()).backward()  # a step enlarges
    state.blur.step(0, 0.0, 100.0)
    assert not np.array_equal(method._trainer.render_view(0), before)
    state.restore(kept)
    np.testing.assert_array_equal(method._trainer.render_view(0), before)
