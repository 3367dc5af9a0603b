"""Terms of the published method, each against numbers worked out by hand from the paper's equation or the released
code."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from made_up import Recorder, frontal
from small_scene import options, training_set
from tolerances import FLOAT32_SCALAR, FLOAT32_VALUE, LEARNED_STEP, PLANE_NORMAL

from dofbench.core.budget import Budget
from dofbench.core.lens import DisparityRange
from dofbench.runtime.raster import Raster
from dofbench.training.common.depth import rendered_range
from dofbench.training.common.lenses import LearnedLenses, LensOptions
from dofbench.training.common.losses import AdaptationOptions
from dofbench.training.common.views import ScaledView
from dofbench.training.gaussians.forward_model import SharpView
from dofbench.training.gaussians.surface_losses import normal_consistency
from dofbench.training.gaussians.trainer import Trainer
from dofbench.training.gaussians.training_state import TrainingState

RANGE = DisparityRange(0.1, 0.6)


def step_function(x: float) -> float:
    """Eq. 10 with the released constants, a = 15 and b = 0.3."""
    return 1 / (1 + math.exp(-15 * (x - 0.3)))


def test_eq_11_closes_the_aperture_in_focus_and_leaves_it_open_elsewhere() -> None:
    state = TrainingState(training_set(), options(adaptation_aperture=True, adaptation_from=0.0), 0)
    assert state.lenses is not None
    raster = Raster(*(torch.ones(4, 4) for _ in range(6)))
    view = ScaledView(0, "v0", state.cameras[0], torch.zeros(4, 4, 3), None, None)
    adapted = state.shot(view, SharpView(lambda: raster), state.adaptation(0.5))
    plain = state.shot(view, SharpView(lambda: raster), state.adaptation(0.5).at(-1.0))
    aperture, focus = state.lenses.aperture_and_focus(0)
    assert aperture > 0.1
    # Normalised disparities at these distances from the focus, in scene units.
    for distance in (0.05, 0.3, 0.6):
        bounds = adapted.bounds
        disparity = torch.tensor(bounds.q_min + (focus + distance) * (bounds.q_max - bounds.q_min))
        share = float((adapted.radius(disparity) / plain.radius(disparity)).detach())
        assert share == pytest.approx(step_function(distance), rel=FLOAT32_VALUE)


def test_the_aperture_is_narrowed_from_its_share_of_the_training_on() -> None:
    adaptation = AdaptationOptions(adaptation_aperture=True, adaptation_from=0.4)
    assert adaptation.at(0.4) is adaptation and not adaptation.at(0.39).active


def test_one_minus_psi_is_stretched_to_the_view_s_own_distances() -> None:
    x = torch.tensor([[0.1, 0.15], [0.2, 0.12]])
    found = AdaptationOptions(adaptation="one_minus_psi").loss_weight(x)
    assert found is not None
    expected = [[1 - step_function((float(one) - 0.1) / 0.1) for one in row] for row in x]
    assert np.allclose(found.numpy(), expected, atol=FLOAT32_VALUE)


def moved(lenses: LearnedLenses, progress: float, cooldown: float = 1.0) -> float:
    """How far one step moves the first view's learned numbers: Adam's first step is the rate itself."""
    before = torch.tensor(lenses.state()["raw"])
    slope, offset = lenses.forward(0)
    (slope + offset).backward()
    lenses.step(0, progress, cooldown)
    return float((torch.tensor(lenses.state()["raw"]) - before).abs().max())


def test_a_lens_stands_still_until_it_is_its_time() -> None:
    def fresh() -> LearnedLenses:
        return LearnedLenses(1, RANGE, LensOptions(lens_from=0.3, lens_lr=1e-2, lens_lr_final=1e-2))

    assert moved(fresh(), 0.29) == 0
    assert moved(fresh(), 0.3) == pytest.approx(1e-2, abs=LEARNED_STEP)


@pytest.mark.parametrize(
    ("progress", "cooldown", "expected"), [(0.0, 1.0, 1e-2), (0.5, 1.0, 1e-3), (1.0, 0.25, 2.5e-5)]
)
def test_a_lens_s_rate_falls_exponentially_and_cools_down(progress: float, cooldown: float, expected: float) -> None:
    lenses = LearnedLenses(1, RANGE, LensOptions(lens_lr=1e-2, lens_lr_final=1e-4))
    assert moved(lenses, progress, cooldown) == pytest.approx(expected, abs=LEARNED_STEP)


def test_a_training_step_hands_the_cooldown_on_to_the_lens(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[float, float]] = []
    monkeypatch.setattr(
        LearnedLenses, "step", lambda self, view, progress, cooldown=1.0: told.append((progress, cooldown))
    )
    trainer = Trainer(training_set(), options(steps=10, cooldown_from=0.5, cooldown_to=0.2), 0)
    trainer.fit(Budget(steps=10), Recorder())
    assert len(told) == 10 and told[-1][1] < 0.5
    for progress, cooldown in told:
        assert cooldown == pytest.approx(1 - 0.8 * max(0.0, progress - 0.5) / 0.5)


def test_without_a_surface_the_range_is_the_sparse_points() -> None:
    assert rendered_range(torch.ones(4, 4), torch.zeros(4, 4), RANGE) is RANGE


def test_the_rendered_range_ends_at_the_95th_percentile() -> None:
    disparity = torch.linspace(0.0, 1.0, 101).reshape(1, 101) + 0.2
    found = rendered_range(disparity, torch.ones(1, 101), RANGE)
    assert found.q_min == pytest.approx(0.2, rel=FLOAT32_SCALAR)
    assert found.q_max == pytest.approx(1.15, rel=FLOAT32_SCALAR)
    halves = torch.ones(1, 101)
    halves[:, 51:] = 0.0  # without a surface
    assert rendered_range(disparity, halves, RANGE).q_max == pytest.approx(0.2 + 0.95 * 0.5, rel=FLOAT32_SCALAR)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6])
def test_the_median_depth_s_normals_have_their_share(share: float) -> None:
    """Splats that face the camera, an expected depth that does too, and a median depth that is steep."""
    camera, height, width = frontal(20, 16, 20.0), 16, 20
    flat = torch.full((height, width), 4.0, dtype=torch.float64)
    # The plane z = 4 + x in the camera's frame: its normal towards the camera is (1, 0, -1) / sqrt(2).
    x = (torch.arange(width, dtype=torch.float64) + 0.5 - camera.cx) / camera.fx
    steep = (4.0 / (1 - x)).expand(height, width)
    normal = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64).expand(height, width, 3)
    ones = torch.ones(height, width, dtype=torch.float64)
    found = float(normal_consistency(normal, ones, flat, steep, camera, share))
    assert found == pytest.approx(share * (1 - math.sqrt(0.5)), abs=PLANE_NORMAL)
