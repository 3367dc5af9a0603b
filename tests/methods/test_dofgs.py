"""DOF-GS: learned lenses, and a loss where the view is in focus."""

from __future__ import annotations

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
from tolerances import FLOAT32_VALUE

from dofbench.core.lens import PhysicalLens
from dofbench.methods.dofgs.method import DOFGS, FocusedBlur, FocusOptions
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
