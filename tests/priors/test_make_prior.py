"""From options to priors, from priors to the trainer, and the order of checks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tolerances import FLOAT32_SCALAR

from dofbench.core.budget import Budget
from dofbench.core.errors import InputError, Status
from dofbench.running.compiling import miniature
from dofbench.running.observer import OneStep
from dofbench.training.common.depth import sparse_depth
from dofbench.training.common.depth_map import DepthMap
from dofbench.training.common.priors import DensePrior, make_prior, with_points_behind, with_surface_points
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.trainer import Trainer


class _Forever:
    def seconds(self) -> float:
        return 0.0

    def after_step(self, step: int, loss: float) -> bool:
        return True

    def __init__(self) -> None:
        self.told: list[tuple[str, int, int]] = []

    def stage(self, name: str, done: int, total: int) -> None:
        self.told.append((name, done, total))


def _by_pixel(samples) -> dict[tuple[int, int], float]:
    """Depth by pixel; of several points in one pixel the last."""
    pixels = zip(samples.rows.tolist(), samples.columns.tolist(), strict=True)
    return dict(zip(pixels, samples.depth.tolist(), strict=True))


def _options(**overrides) -> GaussianOptions:
    return GaussianOptions().with_overrides(
        {
            "steps": 12,
            "sh_degree": 0,
            "adaptation": "off",
            "normal_weight": 0.0,
            "depth_space": "disparity",
            "depth_norm": "l1",
            **overrides,
        }
    )


def test_sparse_is_what_the_points_say(photographed):
    prior = make_prior(photographed.training_set, _options().prior, seed=0, steps=1)
    camera = photographed.training_set.views[1].camera
    expected = sparse_depth(photographed.training_set.points, camera, 1)
    assert torch.equal(prior.samples(1, camera).depth, expected.depth)


def test_stereo_has_the_points_too(photographed):
    training_set = photographed.training_set
    prior = make_prior(training_set, _options(depth_prior="stereo").prior, seed=0, steps=1)
    camera = training_set.views[1].camera
    points = _by_pixel(sparse_depth(training_set.points, camera, 1))
    found = _by_pixel(prior.samples(1, camera))
    assert points and all(found[pixel] == depth for pixel, depth in points.items())
    assert len(found) > 5 * len(points)


@pytest.mark.parametrize(
    ("overrides", "part"),
    [
        ({"depth_prior": "colmap"}, "depth_prior_workspace"),
        ({"depth_prior": "stereo", "depth_prior_file": "n.pt"}, "depth_prior_file"),
        ({"depth_prior": "network", "depth_prior_workspace": "dense"}, "depth_prior_workspace"),
    ],
)
def test_files_that_do_not_go_with_the_prior_are_named(photographed, overrides, part):
    with pytest.raises(InputError, match=part) as caught:
        make_prior(photographed.training_set, _options(**overrides).prior, seed=0, steps=1)
    assert "\n" not in str(caught.value)


def test_a_map_at_half_the_size_mixes_nothing(photographed):
    camera = photographed.training_set.views[0].camera
    depth = np.zeros((camera.height, camera.width), np.float32)
    depth[::3] = 2.0
    depth[1::3] = 8.0
    known = DepthMap(depth, (depth > 0).astype(np.float32))
    half = known.samples(camera.resized(camera.width // 2, camera.height // 2))
    assert set(half.depth.tolist()) == {2.0, 8.0}
    assert int(half.rows.max()) < camera.height // 2 and int(half.columns.max()) < camera.width // 2
    full = known.samples(camera)
    assert torch.equal(full.depth, torch.from_numpy(depth[depth > 0]))


@pytest.mark.slow
def test_training_by_stereo_brings_depth_nearer_to_the_truth(photographed):
    """Trainings from the same start, in which depth is the only loss: the result follows the prior's depth."""
    errors = {}
    for weight in (0.0, 1.0):
        options = _options(
            depth_prior="stereo", depth_weight=weight, coarse_until=0.5, steps=120, lens=False, densify_from=1.0
        )
        trainer = Trainer(photographed.training_set, options, 0)
        outcome = trainer.fit(Budget(), _Forever())
        assert outcome.status is Status.OK
        assert ("depth prior" in outcome.stages) and (outcome.stages["depth prior"] > 0)
        found = [trainer.render(view.camera, None).depth for view in photographed.training_set.views]
        errors[weight] = np.mean(
            [
                np.abs(1 / one[one > 0] - 1 / true[one > 0]).mean()
                for one, true in zip(found, photographed.truth, strict=True)
            ]
        )
    assert errors[1.0] < 0.9 * errors[0.0]


def test_gaussians_start_on_the_priors_surfaces(photographed):
    training_set = photographed.training_set
    prior = make_prior(training_set, _options(depth_prior="stereo").prior, seed=0, steps=1)
    cloud = with_surface_points(training_set, prior, 900, 0)
    own = training_set.points
    assert np.array_equal(cloud.xyz[: len(own)], own.xyz) and len(cloud) == len(own) + 900
    # The first view's share comes first, and lies where the view has those depths.
    camera = training_set.views[0].camera
    xy, depth = camera.project(cloud.xyz[len(own) : len(own) + 150])
    known = _by_pixel(prior.samples(0, camera))
    assert np.allclose([known[int(y), int(x)] for x, y in xy], depth, rtol=FLOAT32_SCALAR)
    trainer = Trainer(training_set, _options(depth_prior="stereo", start_points=900, densify_from=1.0), 0)
    held = trainer.gaussians
    observer = _Forever()
    assert trainer.fit(Budget(), observer).status is Status.OK
    assert len(held) == len(cloud) and held is trainer.gaussians
    assert observer.told[0] == ("depth prior: sweep", 0, 6) and ("depth prior: sweep", 6, 6) in observer.told


def _half_known(training_set, depth: float) -> DensePrior:
    """Depth in the left half of every view alone."""
    maps = []
    for view in training_set.views:
        known = np.zeros(view.image.shape[:2], np.float32)
        known[:, : known.shape[1] // 2] = 1
        maps.append(DepthMap(depth * known, known))
    return DensePrior(maps)


def test_points_start_behind_what_is_known_where_nothing_is(photographed):
    training_set, near = photographed.training_set, 2.0
    points = training_set.points
    cloud = with_points_behind(training_set, points, _half_known(training_set, near), 6000, 0)
    # A share of the points asked for, as the unknown share of the image.
    added = len(cloud) - len(points)
    assert np.array_equal(cloud.xyz[: len(points)], points.xyz) and 0.45 * 6000 < added < 0.5 * 6000
    # The first view's come first, with the colours of its pixels.
    view = training_set.views[0]
    count = added // len(training_set.views)
    own = slice(len(points), len(points) + count)
    xy, depth = view.camera.project(cloud.xyz[own])
    assert (xy[:, 0] > view.camera.width / 2).all(), "where no depth is known"
    assert np.array_equal(cloud.rgb[own], view.image[tuple(xy.astype(int).T[::-1])])
    # Evenly in disparity, from near infinity to the nearest known depth.
    share = near / depth
    assert 0 < share.min() < 0.05 and 0.95 < share.max() < 1
    assert np.abs(np.quantile(share, [0.25, 0.5, 0.75]) - [0.25, 0.5, 0.75]).max() < 4 * 0.5 / np.sqrt(count)


def test_a_few_unknown_pixels_start_nothing_behind(photographed):
    training_set = photographed.training_set
    maps = []
    for view in training_set.views:
        known = np.ones(view.image.shape[:2], np.float32)
        known[:, : round(0.06 * known.shape[1])] = 0  # 5 % of the pixels are far enough from known ones
        maps.append(DepthMap(2 * known, known))
    assert len(with_points_behind(training_set, training_set.points, DensePrior(maps), 6000, 0)) == len(
        training_set.points
    )


def test_no_points_start_behind_where_all_is_known_or_masked(photographed):
    training_set = photographed.training_set
    masked = replace(
        training_set,
        views=tuple(
            replace(view, mask=np.arange(view.camera.width)[None] < np.full((view.camera.height, 1), 80))
            for view in training_set.views
        ),
    )
    prior = _half_known(training_set, 2.0)
    assert len(with_points_behind(masked, masked.points, prior, 6000, 0)) == len(masked.points)


def test_the_training_starts_with_them(photographed):
    found = []
    for behind in (0.0, 1.0):
        chosen = _options(depth_prior="stereo", start_points=900, start_behind=behind, steps=1, densify_from=1.0)
        trainer = Trainer(photographed.training_set, chosen, 0)
        trainer.fit(Budget(), _Forever())
        found.append(len(trainer.gaussians))
    assert found[0] < found[1] < found[0] + 900


def test_a_start_needs_no_supervision(photographed):
    found = []
    for prior in ("stereo", "sparse"):
        start = 900 if prior == "stereo" else 0
        trainer = Trainer(
            photographed.training_set,
            _options(depth_prior=prior, start_points=start, depth_weight=0.0, steps=1, densify_from=1.0),
            0,
        )
        trainer.fit(Budget(), _Forever())
        found.append(len(trainer.gaussians))
    assert found[0] == found[1] + 900


def test_sparse_has_no_surfaces_to_start_on(photographed):
    with pytest.raises(InputError, match="start_points"):
        Trainer(photographed.training_set, _options(start_points=10), 0).fit(Budget(), _Forever())


def test_the_same_seed_trains_to_the_same_bits_with_a_prior(photographed):
    found = []
    for _ in range(2):
        trainer = Trainer(photographed.training_set, _options(depth_prior="stereo", start_points=300), 3)
        trainer.fit(Budget(), _Forever())
        found.append(trainer.gaussians.parameters["means"].detach().numpy().tobytes())
    assert found[0] == found[1]


@pytest.mark.parametrize("prior", ["stereo", "network"])
def test_every_view_of_a_prior_is_reported(photographed, prior):
    told, count = [], len(photographed.training_set.views)
    make_prior(
        photographed.training_set,
        _options(depth_prior=prior).prior,
        seed=0,
        steps=1,
        progress=lambda *given: told.append(given),
    )
    stages = list(dict.fromkeys(stage for stage, _, _ in told))
    assert all(stage.startswith("depth prior: ") for stage in stages)
    assert told == [(stage, done, count) for stage in stages for done in range(count + 1)]


def test_the_option_to_look_again_reaches_stereo(photographed):
    """And a number that makes no sense is named."""
    known = [
        int(
            sum(
                (one.depth > 0).sum()
                for one in make_prior(
                    photographed.training_set,
                    _options(depth_prior="stereo", depth_prior_coarser=count).prior,
                    seed=0,
                    steps=1,
                ).maps
            )
        )
        for count in (0, 1)
    ]
    assert known[1] > known[0]
    with pytest.raises(InputError, match="depth_prior_coarser"):
        _options(depth_prior_coarser=-1)


def test_a_miniature_is_the_same_scene_with_few_pixels(photographed):
    own, small = photographed.training_set, miniature(photographed.training_set)
    assert [view.name for view in small.views] == [view.name for view in own.views]
    assert small.points is own.points
    for view, before in zip(small.views, own.views, strict=True):
        assert max(view.image.shape) <= 96 and view.image.shape == (view.camera.height, view.camera.width, 3)
        assert view.camera.fx / view.camera.width == pytest.approx(before.camera.fx / before.camera.width)


def test_warming_up_takes_one_step_and_no_tuning_to_speak_of(photographed, monkeypatch):
    from dofbench.training.common.priors import network

    steps = []
    monkeypatch.setattr(network, "tune", lambda *arguments, **given: steps.append(given["steps"]))
    trainer = Trainer(miniature(photographed.training_set), _options(depth_prior="tuned"), 0)
    assert trainer.fit(Budget(steps=1), OneStep()).status is Status.OK
    assert steps == [1]


def test_a_tuning_that_diverges_is_a_typed_failure(photographed, monkeypatch):
    from dofbench.training.common.priors import network

    def fail(*arguments, **given):
        raise FloatingPointError("views v: loss is nan at tuning step 3")

    monkeypatch.setattr(network, "tune", fail)
    outcome = Trainer(photographed.training_set, _options(depth_prior="tuned"), 0).fit(Budget(), _Forever())
    assert outcome.status is Status.DIVERGED and outcome.nonfinite[0].stage == "depth prior"
    assert "tuning step 3" in outcome.message


def test_a_network_that_is_not_there_is_named(photographed, tmp_path: Path):
    options = _options(depth_prior="network", depth_prior_file=str(tmp_path / "none.pt"))
    with pytest.raises(InputError, match=r"none\.pt: found no such file"):
        make_prior(photographed.training_set, options.prior, seed=0, steps=1)
