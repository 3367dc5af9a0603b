"""The whole loop on a small scene: it learns, repeats bit for bit, stops at bad numbers, excludes outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import Recorder
from small_scene import HEIGHT, WIDTH, options, training_set
from small_scene import cameras as _cameras
from small_scene import options as _options
from small_scene import training_set as _training_set
from tolerances import UNSEEN

from dofbench.core.budget import Budget
from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet
from dofbench.core.errors import Ended, Status
from dofbench.running.failures import classify
from dofbench.runtime.device_memory import would_fit
from dofbench.training.common.depth import sparse_depth
from dofbench.training.common.views import MOST, VISITS, OutlierOptions, OutlierViews, ViewOrder
from dofbench.training.gaussians import lens_models
from dofbench.training.gaussians import trainer as module
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
    taken = lens_models.views_from_lens
    monkeypatch.setattr(lens_models, "views_from_lens", lambda *given: seen.append(given[2]) or taken(*given))
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


GIB = 2**30


def memory(monkeypatch: pytest.MonkeyPatch, free: float, in_use: float, held: float) -> None:
    """A GPU with so many GiB free, and so many in use and held by this process."""
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (int(free * GIB), 80 * GIB))
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda device: int(in_use * GIB))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: int(held * GIB))


@pytest.mark.parametrize(
    ("free", "in_use", "held", "asked", "expected"),
    [
        (1.0, 6.0, 7.0, "2.00 GiB", 9e5),  # 8 GiB needed where 8 are: but for what is lost between pieces
        (1.0, 14.0, 15.0, "2.00 GiB", 9e5),
        (2.0, 14.0, 14.0, "18.00 GiB", 4.5e5),  # 32 GiB needed where 16 are
        (0.0, 8.0, 8.0, "512.00 MiB", 8.5e5),
        (0.0, 8.0, 8.0, "", 9e5),
    ],
)
def test_what_fits_is_in_proportion_to_the_memory(
    free: float, in_use: float, held: float, asked: str, expected: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory(monkeypatch, free, in_use, held)
    message = (
        f"CUDA out of memory. Tried to allocate {asked}. GPU 0 has a total capacity of 80.00 GiB" if asked else "?"
    )
    assert would_fit(1_000_000, "cuda", torch.OutOfMemoryError(message)) == expected


def test_training_ends_with_the_number_of_gaussians_that_would_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    memory(monkeypatch, 2.0, 14.0, 14.0)
    take_step = module.take_step

    def full(state, step, *rest):
        if step == 3:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 18.00 GiB. GPU 0 has")
        return take_step(state, step, *rest)

    monkeypatch.setattr(module, "take_step", full)
    with pytest.raises(
        Ended, match=r"^250 Gaussians at step 2 are too many for cpu; try --set max_gaussians=110$"
    ) as end:
        Trainer(training_set(), options(), seed=0).fit(Budget(steps=5), Recorder())
    assert classify(end.value)[0] is Status.OUT_OF_MEMORY


def _found(losses, visits=VISITS):
    views = OutlierViews(len(losses))
    for _ in range(visits):
        for view, loss in enumerate(losses):
            views.record(view, loss)
    return views.found()


def test_a_loss_far_above_the_others_is_an_outlier():
    losses = list(0.05 + 0.001 * np.arange(12))
    assert _found(losses) == set()
    losses[4] = 0.2
    assert _found(losses) == {4}
    assert _found(losses, VISITS - 1) == set()  # not seen often enough


@given(st.lists(st.floats(0.05, 0.069), min_size=8, max_size=30))
def test_losses_that_differ_by_less_than_two_fifths_have_none(losses):
    assert _found(losses) == set()


def test_no_more_than_a_share_is_left_out_the_worst_first():
    losses = [0.05] * 12 + [0.5, 0.9, 0.6, 0.8, 0.7]
    assert len(_found(losses)) == int(MOST * len(losses)) == 4 and _found(losses) == {13, 14, 15, 16}
    assert _found([0.05] * 5 + [0.9] * 2) == set()  # too few views for a meaningful median


def test_a_photograph_of_something_else_is_trained_on_no_more():
    """A training set of copies of three views, in which one photograph is replaced by noise."""
    given_set, random = training_set(), np.random.default_rng(0)
    views = [replace(given_set.views[number % 3], name=f"v{number}") for number in range(9)]
    views[5] = replace(views[5], image=random.uniform(size=views[5].image.shape).astype(np.float32))
    chosen = options(steps=80, lens=False, adaptation="off", normal_weight=0, outlier_views=True)
    trainer = Trainer(TrainingSet(tuple(views), given_set.points), chosen, 0)
    trainer.fit(Budget(), Recorder())
    assert trainer.left_out_views == {5}


def test_a_photograph_that_was_hardly_seen_keeps_all_in():
    """Two visits of every photograph are needed; until then none is left out, whatever the others' losses say."""
    views = OutlierViews(12)
    for view in range(12):
        for _ in range(1 if view == 5 else 2):
            views.record(view, 0.9 if view == 4 else 0.05)
    assert views.found() == set()
    views.record(5, 0.05)
    assert views.found() == {4}


@pytest.mark.parametrize(("progress", "left_out"), [(0.29, set()), (0.3, {4})])
def test_outliers_are_left_out_from_their_share_of_the_training_on(progress, left_out):
    order = ViewOrder(12, OutlierOptions(outlier_views=True, outliers_from=0.3))
    for view in range(12):
        for _ in range(2):
            order.record(view, 0.9 if view == 4 else 0.05)
    seen = [order.next(progress, np.random.default_rng(0)) for _ in range(11)]
    assert order.left_out == left_out and set(seen) & left_out == set()
