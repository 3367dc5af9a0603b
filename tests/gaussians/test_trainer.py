"""The whole loop on a small scene: it learns, repeats bit for bit, and stops at the first bad number."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up import Recorder
from small_scene import HEIGHT, WIDTH
from small_scene import cameras as _cameras
from small_scene import options as _options
from small_scene import training_set as _training_set
from tolerances import UNSEEN

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import Status
from dofbench.training.common.depth import sparse_depth
from dofbench.training.gaussians.forward import lens_samples
from dofbench.training.gaussians.model import NEAR
from dofbench.training.gaussians.render import rasterise
from dofbench.training.gaussians.trainer import Trainer


@pytest.mark.parametrize(
    "overrides",
    [
        {"lens": False, "adaptation": "off"},
        {},
        {
            "blur_to_depth": True,
            "adaptation": "psi",
            "adaptation_ssim": True,
            "adaptation_aperture": True,
            "normal_median": 0.6,
            "grow_absolute": True,
        },
        {
            "lens_range": "render",
            "lens_clip": True,
            "clone_place": "drawn",
            "lens_update": "dense",
            "lens_energy": "algorithm1",
            "coarse_until": 0.4,
            "depth_norm": "l1",
            "depth_space": "disparity",
            "prune_depth_graded": True,
            "filter_2d": 0.0,
        },
        {
            "lens_model": "samples",
            "lens_rings": 1,
            "lens_samples_from": 0.3,
            "lens_rings_from": 0.7,
            "adaptation": "psi",
            "lens_activation": "ends",
            "lens_per": "scene",
            "grow_absolute": True,
            "blur_to_depth": True,
        },
        {"normal_form": "pixel", "normal_median": 0.6, "distortion_weight": 1.0},
    ],
)
def test_training_lowers_the_loss(overrides):
    recorder = Recorder()
    trainer = Trainer(_training_set(), _options(**overrides), 0)
    outcome = trainer.fit(Budget(), recorder)
    assert outcome.status is Status.OK and outcome.steps == 90
    assert np.mean(recorder.losses[-9:]) < 0.7 * np.mean(recorder.losses[:9])
    rendering = trainer.render(_cameras()[0], None)
    assert rendering.image.shape == (HEIGHT, WIDTH, 3) and np.isfinite(rendering.image).all()
    # A pixel's depth is a mean over Gaussians on two planes, more of the farther one where a point of it is seen.
    seen = sparse_depth(_training_set().points, _cameras()[0], 0)
    rendered = rendering.depth[seen.rows, seen.columns]
    near, far = (np.median(rendered[seen.depth.numpy() == plane]) for plane in (3.0, 6.0))
    assert 3.0 < near < far < 6.0


@pytest.mark.parametrize(("aperture", "rings"), [(0.05, 0), (60.0, 1)])
def test_a_photograph_trains_through_as_many_points_as_its_circles_need(monkeypatch, aperture: float, rings: int):
    """Circles below a pixel and a half need the lens's centre alone; in units of the paper's A, 2 % of 48 px."""
    seen = []
    taken = lens_samples.views_from_lens
    monkeypatch.setattr(lens_samples, "views_from_lens", lambda *given: seen.append(given[2]) or taken(*given))
    options = _options(
        lens_model="samples",
        lens_rings=1,
        lens_samples_from=0.0,
        lens_init_aperture=aperture,
        lens_init_focus=0.0,
        lens_from=1.0,
        lens_range="points",
    )
    trainer = Trainer(_training_set(), options, 0)
    assert trainer.fit(Budget(steps=4), Recorder()).status is Status.OK
    assert seen == [rings] * 4


def test_the_distortion_loss_draws_the_gaussians_of_a_ray_together():
    spreads = {}
    for weight in (0.0, 1000.0):
        trainer = Trainer(_training_set(), _options(distortion_weight=weight, distortion_from=0.2), 0)
        assert trainer.fit(Budget(), Recorder()).status is Status.OK
        spreads[weight] = 0.0
        for camera in _cameras():
            raster = rasterise(trainer.gaussians, camera, trainer.options.appearance, geometry="distortion")
            spreads[weight] += float((raster.distortion / raster.alpha.clamp(min=0.01) ** 2).detach().mean())
    assert spreads[1000.0] < spreads[0.0] / 2


def test_the_same_seed_gives_the_same_bits():
    runs = []
    for _ in range(2):
        trainer = Trainer(_training_set(), _options(), 3)
        trainer.fit(Budget(), Recorder())
        runs.append(trainer)
    for name, value in runs[0].gaussians.parameters.items():
        assert torch.equal(value, runs[1].gaussians.parameters[name]), name
    assert runs[0].lens_estimates() == runs[1].lens_estimates()


def test_another_seed_gives_other_numbers():
    results = []
    for seed in (0, 1):
        recorder = Recorder()
        Trainer(_training_set(), _options(steps=20), seed).fit(Budget(), recorder)
        results.append(recorder.losses)
    assert results[0] != results[1]


def test_a_nan_ends_the_run_as_diverged_and_names_view_and_stage():
    trainer = Trainer(_training_set(bad_view=1), _options(), 0)
    recorder = Recorder()
    outcome = trainer.fit(Budget(), recorder)
    assert outcome.status is Status.DIVERGED
    (event,) = outcome.nonfinite
    assert event.view == "v1" and event.stage == "loss" and event.step == outcome.steps <= 3
    assert all(np.isfinite(loss) for loss in recorder.losses)
    # The parameters are still finite, since the step with the bad number wasn't carried out.
    assert all(bool(torch.isfinite(value).all()) for value in trainer.gaussians.parameters.values())
    assert np.isfinite(trainer.render(_cameras()[0], None).image).all()


def test_a_nan_in_a_gradient_is_caught_before_the_optimiser():
    trainer = Trainer(_training_set(), _options(), 0)
    with torch.no_grad():
        trainer.gaussians.parameters["sh_dc"][7, 0] = float("nan")
    outcome = trainer.fit(Budget(steps=5), Recorder())
    assert outcome.status is Status.DIVERGED and outcome.steps == 1


def test_the_observer_can_stop_it():
    outcome = Trainer(_training_set(), _options(), 0).fit(Budget(), Recorder(stop_after=7))
    assert outcome.status is Status.OK and outcome.steps == 7


def test_a_budget_of_steps_sets_the_schedule():
    assert Trainer(_training_set(), _options(), 0).fit(Budget(steps=12), Recorder()).steps == 12


@pytest.mark.slow  # compiles every kernel of a training step anew
def test_freshly_compiled_kernels_train_to_the_same_bits_as_cached_ones(tmp_path):
    script = (
        "import hashlib\n"
        "from test_trainer import Budget, Recorder, Trainer, _options, _training_set\n"
        "trainer = Trainer(_training_set(), _options(normal_from=0.0, blur_to_depth=True, normal_median=0.6), 0)\n"
        "trainer.fit(Budget(steps=8), Recorder())\n"
        "digest = hashlib.sha256(repr(trainer.lens_estimates()).encode())\n"
        "for name, value in trainer.gaussians.parameters.items():\n"
        "    digest.update(value.detach().numpy().tobytes())\n"
        "from dofbench.runtime.ops.scatter.cpu_direct_backward import pack_gradient\n"
        "print(digest.hexdigest(), sum(pack_gradient.stats.cache_misses.values()))\n"
    )
    paths = os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": paths}
    command = [sys.executable, "-c", script]
    found = [
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    ]
    assert list(tmp_path.rglob("*.nbc")) and len(found[0][0]) == 64
    assert found[0] == found[1]
    # The kernels of the lens were compiled by the second process, not by this one.
    assert found[0][1] == "0"


def test_a_scene_in_other_units_is_learned_alike() -> None:
    """The unit of a reconstruction is arbitrary. In one 64 times as large, a power of two, nothing is rounded anew but
    the logarithms of the scales; and the scene then lies nearer than 3DGS's near plane, 0.2 of its units."""
    in_disparity = {"lens": False, "depth_space": "disparity"}  # the published loss is of depth in scene units
    images, nearest = [], []
    for unit in (1.0, 64.0):
        shown = _training_set()
        views = tuple(replace(view, camera=_in_units(view.camera, unit)) for view in shown.views)
        trainer = Trainer(
            TrainingSet(views, replace(shown.points, xyz=shown.points.xyz / unit)), _options(**in_disparity), 0
        )
        assert trainer.fit(Budget(steps=30), Recorder()).status is Status.OK
        nearest.append(trainer.gaussians.near)
        with torch.no_grad():
            images.append(rasterise(trainer.gaussians, views[0].camera, trainer.options.appearance).color)
    assert nearest == [NEAR, pytest.approx(3 / 64 / 4)]  # the nearer plane stands at 3
    assert images[0].std() > 0.1 and (images[0] - images[1]).abs().mean() < UNSEEN


def _in_units(camera: Camera, unit: float) -> Camera:
    moved = camera.world_to_camera.copy()
    moved[:3, 3] /= unit
    return replace(camera, world_to_camera=moved)


def test_every_step_of_the_budget_is_taken_and_told():
    told = []

    class Listening(Recorder):
        def after_step(self, step, loss):
            told.append(step)
            return True

    outcome = Trainer(_training_set(), _options(steps=50), 0).fit(Budget(steps=7), Listening())
    assert told == [1, 2, 3, 4, 5, 6, 7] and outcome.steps == 7


def test_the_filter_of_a_trained_scene_is_that_of_where_its_gaussians_end():
    """It is computed anew every so often, and Gaussians move after the last time."""
    trainer = Trainer(_training_set(), _options(steps=7, densify_from=1.0, coarse_until=0.5), 0)
    trainer.fit(Budget(steps=7), Recorder())
    kept = trainer.gaussians.filter_3d.clone()
    trainer.gaussians.update_filter_3d(_cameras())
    assert torch.equal(kept, trainer.gaussians.filter_3d)


def test_with_smaller_photographs_the_filter_is_theirs():
    trainer = Trainer(_training_set(), _options(steps=8, densify_from=1.0, coarse_until=0.5), 0)
    sizes, filters = [], []

    class Watching(Recorder):
        def after_step(self, step: int, loss: float) -> bool:
            sizes.append(trainer.state.cameras[0].width)
            filters.append(float(trainer.gaussians.filter_3d.median()))
            return super().after_step(step, loss)

    trainer.fit(Budget(steps=8), Watching())
    assert sizes == [WIDTH // 2] * 4 + [WIDTH] * 4
    # A pixel of a photograph of half the size is twice as large.
    assert 1.9 < filters[0] / filters[-1] < 2.1
