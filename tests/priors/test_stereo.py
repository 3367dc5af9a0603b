"""Stereo on shallow photographs against exact depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tolerances import STEREO_OUTLIERS, SWEEP_REACH

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.images import resize
from dofbench.training.common.depth import sparse_depth
from dofbench.training.common.priors.stereo import choose_sources, disparity_bounds, plane_map, stereo_depth


@pytest.fixture(scope="module")
def maps(photographed):
    return stereo_depth(photographed.training_set)


def test_most_of_what_it_finds_is_right_and_it_finds_much(photographed, maps):
    found, right = photographed.shares(maps, within=0.05)
    assert found > 0.25
    assert right > 1 - STEREO_OUTLIERS, right


def test_it_finds_far_more_than_the_sparse_points(photographed, maps):
    views = photographed.training_set.views
    sparse = sum(
        len(sparse_depth(photographed.training_set.points, view.camera, index).depth)
        for index, view in enumerate(views)
    )
    assert sum(int((one.depth > 0).sum()) for one in maps) > 5 * sparse


def test_weight_tells_good_from_bad(photographed, maps):
    depth, weight = (np.stack([getattr(one, name) for one in maps]) for name in ("depth", "weight"))
    known = depth > 0
    assert ((weight > 0) == known).all() and weight.max() <= 1
    error = np.abs(depth[known] / np.stack(photographed.truth)[known] - 1)
    order = np.argsort(weight[known])
    quarter = len(order) // 4
    assert error[order[-quarter:]].mean() < 0.7 * error[order[:quarter]].mean()


def test_what_agrees_with_no_other_view_is_left_out(photographed):
    """One photograph shows something else: its depth must not be kept, and it must not confirm others' depth."""
    views = photographed.training_set.views
    noise = np.random.default_rng(0).uniform(0, 1, views[0].image.shape).astype(np.float32)
    other = replace(photographed.training_set, views=(replace(views[0], image=noise), *views[1:4]))
    found = stereo_depth(other)
    assert (found[0].depth > 0).mean() < 0.01
    assert (found[1].depth > 0).mean() > 0.1


def test_two_views_are_enough(photographed):
    pair = replace(
        photographed.training_set,
        views=photographed.training_set.views[:2],
        points=photographed.training_set.points.seen_by([0, 1]),
    )
    assert (stereo_depth(pair)[0].depth > 0).mean() > 0.1


def test_without_tracks_the_points_still_say_where_to_look(photographed, maps):
    blind = replace(photographed.training_set, points=replace(photographed.training_set.points, views=None))
    low, high = disparity_bounds(blind)
    own = disparity_bounds(photographed.training_set)
    assert low == pytest.approx(own[0], rel=SWEEP_REACH) and high == pytest.approx(own[1], rel=SWEEP_REACH)
    assert all(len(set(chosen)) == 4 for chosen in choose_sources(blind))


def test_views_of_other_sizes_are_matched_too(photographed, maps):
    """Every second photograph half again as large: the others' depth hardly changes."""
    views = list(photographed.training_set.views)
    views[::2] = [
        replace(view, camera=view.camera.resized(240, 180), image=resize(view.image, 240, 180)) for view in views[::2]
    ]
    found = stereo_depth(replace(photographed.training_set, views=tuple(views)))
    assert found[0].depth.shape == (180, 240)
    assert (found[1].depth > 0).mean() > 0.8 * (maps[1].depth > 0).mean()
    both = (found[1].depth > 0) & (maps[1].depth > 0)
    # Its planes lie elsewhere, so the depth changes, but by less than either is wrong.
    changed = np.median(np.abs(found[1].depth[both] / maps[1].depth[both] - 1))
    truth = photographed.truth[1][both]
    assert changed < min(np.median(np.abs(one[1].depth[both] / truth - 1)) for one in (found, maps))


def test_looking_again_at_half_the_size_adds_and_changes_nothing(photographed, maps):
    again = stereo_depth(photographed.training_set, coarser=1)
    for before, after in zip(maps, again, strict=True):
        known = before.depth > 0
        assert np.array_equal(before.depth[known], after.depth[known])
        assert np.array_equal(before.weight[known], after.weight[known])
        assert ((after.weight > 0) == (after.depth > 0)).all() and after.weight[~known].max(initial=0) <= 0.5
    found, right = photographed.shares(again, within=0.05)
    assert found > 1.03 * photographed.shares(maps, within=0.05)[0]
    assert right > 1 - STEREO_OUTLIERS


def test_no_size_is_too_small_to_look_again(photographed, maps):
    """At a quarter of 160 x 120 the images are below the smallest."""
    twice, often = (stereo_depth(photographed.training_set, coarser=count) for count in (1, 5))
    assert all(np.array_equal(one.depth, other.depth) for one, other in zip(twice, often, strict=True))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda training_set: replace(training_set, points=None), "sparse points"),
        (
            lambda training_set: replace(
                training_set, views=training_set.views[:1], points=training_set.points.seen_by([0])
            ),
            "one training view",
        ),
    ],
)
def test_what_stereo_can_not_do_without_is_named(photographed, change, part):
    with pytest.raises(InputError, match=part):
        stereo_depth(change(photographed.training_set))


def test_planes_map_as_the_cameras_project():
    rng = np.random.default_rng(0)
    cameras = []
    for _ in range(2):
        rotation, _ = np.linalg.qr(np.eye(3) + 0.1 * rng.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation * np.sign(np.diag(rotation)), rng.normal(size=3)
        cameras.append(Camera(64, 48, 50.0, 55.0, 30.0, 25.0, pose))
    xy = rng.uniform(0, 40, (20, 2))
    depth = rng.uniform(2, 5, 20)
    local = np.stack([(xy[:, 0] - 30) / 50 * depth, (xy[:, 1] - 25) / 55 * depth, depth, np.ones(20)], axis=1)
    expected, _ = cameras[1].project((local @ cameras[0].camera_to_world.T)[:, :3])
    matrix = plane_map(*cameras)
    mapped = np.c_[xy, np.ones(20)] @ matrix[:, :3].T + matrix[:, 3] / depth[:, None]
    assert np.allclose(mapped[:, :2] / mapped[:, 2:], expected)
