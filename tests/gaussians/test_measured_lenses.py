"""Lenses that are measured while training: where they start, how long they stay, how far they are learned."""

from __future__ import annotations

import numpy as np
import pictured_tabletop as tabletop
import pytest
import torch
from made_up import Recorder

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.core.lens import DisparityRange
from dofbench.methods.cards import find_method
from dofbench.training.common.lenses import LearnedLenses, LensOptions, Ties
from dofbench.training.gaussians.forward_model import Pinhole
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.trainer import Trainer

FOCI, APERTURE = (0.2, 0.5, 0.8), 2.0
# Preset cpu-v2 without what a small picture doesn't need.
SMALL = {
    "colour_per_view": "off",
    "depth_prior": "sparse",
    "start_points": 0,
    "start_behind": 0.0,
    "max_gaussians": 20000,
    "lens_trials": "",
}


def pushed(lenses: LearnedLenses, view: int, steps: int, progress: float) -> tuple[float, float]:
    """Aperture and focus after steps that narrow the lens."""
    for _ in range(steps):
        slope, _ = lenses.forward(view)
        (slope**2).backward()
        lenses.step(view, progress)
    return lenses.aperture_and_focus(view)


def made(aperture: np.ndarray, errors: np.ndarray, ties: Ties, **options: object) -> LearnedLenses:
    chosen = LensOptions(lens_lr=5e-2, lens_lr_final=5e-2, **options)  # type: ignore[arg-type]
    free = LearnedLenses(len(aperture), DisparityRange(0.1, 1.0), chosen)
    return free.measured(aperture, np.array([0.3, 0.6]), errors, ties)


@pytest.mark.parametrize("activation", ["ends", "log", "relu"])
@pytest.mark.parametrize("ties", [Ties.untied(2), Ties((0, 0), (0, 1), (1.0, 1.5))], ids=["each", "tied"])
def test_a_measured_lens_stays_frozen_and_then_near_its_value(activation, ties):
    aperture = 0.8 * np.array(ties.opening)
    lenses = made(
        aperture, np.full((2, 2), 0.1), ties, lens_activation=activation, lens_frozen_until=0.5, lens_within=2.0
    )
    for view, focus in enumerate((0.3, 0.6)):
        assert lenses.aperture_and_focus(view) == pytest.approx((aperture[view], focus), rel=1e-4)
    assert pushed(lenses, 0, 5, 0.4) == pytest.approx((aperture[0], 0.3), rel=1e-4)
    narrowed = pushed(lenses, 0, 60, 0.6)
    assert narrowed[0] == pytest.approx(aperture[0] * np.exp(-0.2), rel=1e-4)
    assert abs(narrowed[1] - 0.3) <= 0.2 + 1e-5


def test_one_lens_for_all_gets_the_median_focus():
    lenses = made(np.array([0.8, 0.8]), np.full((2, 2), 0.1), Ties((0, 0), (0, 0), (1.0, 1.0)), lens_activation="ends")
    assert [lenses.aperture_and_focus(view) for view in (0, 1)] == [pytest.approx((0.8, 0.45), rel=1e-4)] * 2


def test_without_limits_a_measured_lens_is_learned_freely():
    lenses = made(np.array([0.8, 0.8]), np.full((2, 2), 0.1), Ties.untied(2), lens_activation="log", lens_within=0.0)
    assert pushed(lenses, 0, 60, 0.6)[0] < 0.8 * np.exp(-0.5)


def test_the_first_part_has_no_lens():
    options = GaussianOptions().with_overrides({"lens_free_until": 0.2, "lens_model": "samples"})
    models = options.forward_models()
    assert isinstance(models.at(0.1), Pinhole) and not isinstance(models.at(0.2), Pinhole)
    usual = GaussianOptions().with_overrides({"lens_model": "samples"}).forward_models()
    assert [type(models.at(share)) for share in (0.3, 0.6, 1.0)] == [type(usual.at(share)) for share in (0.3, 0.6, 1.0)]


def trained(apertures: tuple[float, ...], steps: int, **options: object) -> Trainer:
    entry = find_method("lensselect")
    method = entry.create({**entry.preset("cpu-v2")[1], **SMALL, "steps": steps, **options}, 0, "cpu")
    outcome = method.fit(tabletop.photographs(apertures, FOCI), Budget(steps=steps), Recorder())
    assert outcome.status is Status.OK
    return method.trainer


def test_a_scene_that_does_not_stand_determines_nothing():
    """After two steps surfaces are where points are, and colours are anything."""
    trainer = trained((0.0,), 10)
    decision = next(one for one in trainer.decisions if one.stage == "lens_measured")
    assert not decision.runs
    assert trainer.lenses is not None and torch.isfinite(torch.tensor(trainer.lenses.aperture_and_focus(0))).all()


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.25, 4.0])
def test_the_twin_comes_back_from_any_start(start):
    """Photographs of known lenses, without any other error: starts a factor of four from the truth."""
    trainer = trained((APERTURE,), 240, lens_init_aperture=start * APERTURE)
    decision = next(one for one in trainer.decisions if one.stage == "lens_measured")
    assert decision.runs, decision.reason
    assert trainer.lenses is not None
    found = np.array([trainer.lenses.aperture_and_focus(view) for view in range(tabletop.count())])
    assert np.mean(np.abs(found[:, 0] / APERTURE - 1)) < 0.2
    assert np.mean(np.abs(found[:, 1] - [FOCI[view % 3] for view in range(tabletop.count())])) < 0.1
