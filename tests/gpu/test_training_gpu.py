"""Training of Gaussians on a device: the CPU's losses, and how often the host waits for the device."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from made_up import Recorder
from pretended_device import pretended
from small_scene import options
from tiny_scene import tiny_scene
from tolerances import FLOAT32_VALUE
from waits_of_steps import Steps

from dofbench.core.budget import Budget
from dofbench.core.errors import Status
from dofbench.training.gaussians.trainer import Trainer

STEPS = 12
BAD = 0  # view whose turn isn't in the first step


# The rasteriser asks for the length of its lists, once for a picture or for all points of a lens.
LISTS = "_local_scalar_dense in gpu_lists.py project_and_list"

# How many aperture samples a photograph needs decides how many pictures are drawn.
POINTS_OF_LENS = "_to_copy in lens_pattern.py rings_for"


def trainer_on(device: str, bad_view: int | None = None, seed: int = 0, **overrides: object) -> Trainer:
    density = {"densify_every": 5, "densify_until": 0.9}
    trainer = Trainer(tiny_scene(bad_view), options(steps=STEPS, **density, **overrides), seed=seed, device=device)
    with torch.no_grad():
        # How a sphere is turned has no effect, so rounding alone would decide where Adam turns it, and where density
        # control then puts its children.
        log_scales = trainer.gaussians.parameters["log_scales"]
        log_scales += log_scales.new_tensor([0.2, -0.3, 0.0])
    return trainer


def trained(trainer: Trainer, steps: int, waits: list[str]) -> Steps:
    observer = Steps(lambda: trainer.state.loss, waits)
    assert trainer.fit(Budget(steps=steps), observer).status is Status.OK
    return observer


def psnr(trainer: Trainer) -> float:
    """Of the photographs as they were learned, dB."""
    wrong = [np.square(trainer.render_view(index) - view.image).mean() for index, view in enumerate(trainer.views)]
    return -10 * float(np.log10(np.mean(wrong)))


def test_a_training_on_a_device_is_that_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loss by loss within rounding; and its score within the spread of the CPU's over seeds."""
    trainers = [trainer_on("cpu", seed=seed) for seed in range(4)]
    expected, *_ = [trained(trainer, STEPS, []) for trainer in trainers]
    with pretended(monkeypatch) as waits:
        trainer = trainer_on("cuda")
        found = trained(trainer, STEPS, waits)
        score = psnr(trainer)
    np.testing.assert_allclose(found.own, expected.own, rtol=FLOAT32_VALUE)
    scores = [psnr(one) for one in trainers]
    assert abs(score - scores[0]) < np.std(scores, ddof=1)
    # The first step also has what comes before it, and the first look; in steps 5 and 10 density control acts.
    usual = [waits for step, waits in enumerate(found.waits, 1) if step not in (1, 5, 10)]
    assert usual == [{LISTS: 1}] * (STEPS - 3)
    assert len(set(found.losses)) == 1 and found.losses[0] == found.own[0]


@pytest.mark.parametrize(
    ("overrides", "expected_waits"),
    [
        ({"lens_model": "samples", "lens_samples_from": 0.0, "adaptation": "off"}, {LISTS: 2, POINTS_OF_LENS: 1}),
        ({"edge_weight": 5.0, "colour_per_view": "affine", "depth_space": "disparity", "depth_norm": "l1"}, {LISTS: 1}),
        (
            {"lens_activation": "ends", "lens_update": "dense", "distortion_weight": 1.0, "distortion_from": 0.0},
            {LISTS: 1},
        ),
        (
            {"adaptation_from": 0.0, "adaptation_aperture": True, "adaptation_ssim": True, "normal_from": 0.0},
            {LISTS: 1},
        ),
        ({"depth_prior": "stereo", "start_points": 6, "depth_space": "disparity"}, {LISTS: 1}),
        ({"lens": False, "lens_clip": True, "normal_form": "pixel", "normal_from": 0.0}, {LISTS: 1}),
    ],
)
def test_nor_does_another_option_have_the_host_wait(
    overrides: dict[str, object], expected_waits: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = trained(trainer_on("cpu", **overrides), 3, [])
    with pretended(monkeypatch) as waits:
        found = trained(trainer_on("cuda", **overrides), 3, waits)
    np.testing.assert_allclose(found.own, expected.own, rtol=FLOAT32_VALUE)
    assert found.waits[1:] == [expected_waits] * 2


def test_a_value_that_is_not_finite_changes_nothing_and_is_told_with_its_step(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = trainer_on("cpu", bad_view=BAD).fit(Budget(steps=6), Recorder())
    before = trainer_on("cpu", bad_view=BAD)
    before.fit(Budget(steps=6), Recorder(stop_after=expected.steps - 1))
    with pretended(monkeypatch):
        trainer = trainer_on("cuda", bad_view=BAD)
        found = trainer.fit(Budget(steps=6), Recorder())
    assert 1 < expected.steps < 6 and expected.status is found.status is Status.DIVERGED
    assert (found.nonfinite[0].step, found.nonfinite[0].view) == (expected.steps, f"v{BAD}")
    for name, parameter in trainer.gaussians.parameters.items():
        left = before.gaussians.parameters[name].detach()
        np.testing.assert_allclose(parameter.numpy(force=True), left, rtol=0, atol=FLOAT32_VALUE)
