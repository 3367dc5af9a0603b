"""Stereo on shallow photographs against exact depth."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE, STEREO_OUTLIERS, SWEEP_REACH

from dofbench.core.cameras import Camera
from dofbench.core.contracts import TrainingSet, TrainingView
from dofbench.core.errors import InputError
from dofbench.core.images import resize
from dofbench.training.common.depth import sparse_depth
from dofbench.training.common.depth_map import DepthMap
from dofbench.training.common.priors import stereo, stereo_sources
from dofbench.training.common.priors.stereo import SOURCES, disparity_bounds, plane_map, stereo_depth
from dofbench.training.common.priors.stereo_sources import choose_sources


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
    assert all(len(set(chosen)) == 4 for chosen in choose_sources(blind, SOURCES))


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


def _turned(degrees: float) -> np.ndarray:
    return np.array([[math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))]])


@pytest.mark.parametrize(
    ("degrees", "worth"),
    [(0.0, 0.0), (1.5, 0.25), (3.0, 1.0), (7.0, 1.0), (12.0, 1.0), (24.0, 0.25), (60.0, 0.04), (180.0, 1 / 225)],
)
def test_angles_of_three_to_twelve_degrees_are_the_best(degrees: float, worth: float) -> None:
    """Below and above the worth falls with the square of the angle's ratio to the bound."""
    assert stereo_sources._fairness(_turned(20.0), _turned(20.0 + degrees)) == pytest.approx([worth], abs=FLOAT64_VALUE)


@pytest.mark.parametrize(("shift", "count"), [(0.01, 16), (0.2, 56), (0.42, 120), (3.0, 192)])
def test_planes_move_the_image_by_three_quarters_of_a_pixel(shift: float, count: int) -> None:
    """Between cameras side by side a disparity moves every pixel by focal length x shift x disparity: 400 x 0.2 x 0.5
    px are 40 px, 53.3 steps, 55 planes with both ends, 56 as a multiple of eight."""
    camera = frontal(80, 60, 400.0)
    found = stereo._planes(
        camera, [frontal(80, 60, 400.0, (shift, 0, 0)), frontal(80, 60, 400.0, (0, shift / 9, 0))], 0.1, 0.6
    )
    assert len(found) == count and found[0] == 0.1 and found[-1] == 0.6
    assert np.ptp(np.diff(found)) < FLOAT64_VALUE


def test_planes_are_as_fine_as_the_source_s_own_pixels() -> None:
    """A source of half the focal length sees half the displacement: 20 px, 26.7 steps, 28 planes, 32 of them."""
    found = stereo._planes(frontal(80, 60, 400.0), [frontal(80, 60, 200.0, (0.2, 0, 0))], 0.1, 0.6)
    assert len(found) == 32


def test_a_source_that_looks_elsewhere_says_nothing_of_the_planes() -> None:
    """Points before this camera lie behind one far in front of it."""
    camera = frontal(80, 60, 400.0)
    assert len(stereo._planes(camera, [frontal(80, 60, 400.0, (0, 0, 50.0))], 0.1, 0.6)) == stereo.PLANES[0]


def test_outlines_are_pixels_with_a_much_farther_surface_nearby() -> None:
    """Pixel by pixel: within three pixels up, down and aside, something farther by 3 % of the range; nothing known is
    as far as can be."""
    random = np.random.default_rng(0)
    depth = 1 / random.choice([0.2, 0.21, 0.5], (20, 30), p=[0.55, 0.43, 0.02])
    depth[15:, 20:] = 0
    expected = np.zeros(depth.shape, bool)
    disparity = np.divide(1, depth, out=np.zeros(depth.shape), where=depth > 0)
    for row, column in np.ndindex(depth.shape):
        window = disparity[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4]
        expected[row, column] = disparity[row, column] - window.min() > 0.03 * 0.5
    assert np.array_equal(stereo._outline(depth, 0.5), expected) and 0 < expected.mean() < 0.5


def test_holes_are_filled_from_the_smaller_map_at_less_weight() -> None:
    depth = np.array([[0.5, 0.0, 3.0, 0.0]] * 2, np.float32)
    weight = np.array([[0.9, 0.0, 0.8, 0.0]] * 2, np.float32)
    coarse = DepthMap(np.array([[7.0, 0.25]], np.float32), np.array([[0.6, 0.4]], np.float32))
    found = stereo._filled(DepthMap(depth, weight), coarse, 0.5)
    assert found.depth.tolist() == [[0.5, 7.0, 3.0, 0.25]] * 2
    assert np.allclose(found.weight, [[0.9, 0.3, 0.8, 0.2]] * 2, rtol=FLOAT32_VALUE)


def test_what_is_kept_of_a_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    """A flat wall, for which matching is said to give these planes, scores and margins: the first and the last plane
    and low scores give no depth, a small margin gives depth without weight, and all else counts by its score."""
    camera = frontal(80, 60, 400.0)
    count = len(stereo._planes(camera, [camera], 0.1, 0.6))
    plane, score, margin = (torch.full((60, 80), value) for value in (3.0, 0.8, 0.2))
    plane[20, :4] = torch.tensor([0.4, 0.6, count - 1.4, count - 1.6])
    score[30, :3] = torch.tensor([0.59, 0.61, 1.2])
    margin[40, :2] = torch.tensor([0.04, 0.06])

    def load(op: str, *, function: str | None = None) -> object:
        if function == "semiglobal":
            return lambda *_, **__: (plane, score, margin)
        return lambda grey, *_, **__: torch.zeros(1)

    monkeypatch.setattr(stereo, "load", load)
    monkeypatch.setattr(stereo, "_outline", lambda depth, extent: np.zeros(depth.shape, bool))
    grey = [(torch.zeros(60, 80), camera)]
    swept = stereo._sweep([grey, grey], 0, [1], 0.1, 0.6)
    expected = 1 / (0.1 + 0.5 * plane.numpy() / (count - 1))
    expected[20, 0] = expected[20, 2] = expected[30, 0] = 0
    assert np.allclose(swept.depth, expected, rtol=FLOAT32_VALUE)
    weight = np.where(expected > 0, np.minimum(score.numpy(), 1), 0)
    weight[40, 0] = 0
    assert np.allclose(swept.weight, weight, rtol=FLOAT32_VALUE)


def test_a_view_is_matched_with_its_four_best_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(stereo, "_sweep", lambda pyramids, index, chosen, *bounds: seen.append(chosen))
    monkeypatch.setattr(stereo, "_Found", lambda swept: SimpleNamespace())
    monkeypatch.setattr(stereo, "_agreed", lambda cameras, swept, index, chosen, device: chosen)
    pyramids = [[(torch.zeros(6, 8), frontal(8, 6, 9.0))]] * 2
    kept = stereo._matched(
        pyramids, [None] * len(pyramids), [[3, 1, 4, 2, 5, 6], [2]], (0.1, 0.6), "", lambda *told: None
    )
    assert seen == [[3, 1, 4, 2], [2]] and kept == [[3, 1, 4, 2, 5, 6], [2]]


def test_views_without_a_common_point_come_last() -> None:
    """Cameras side by side. The second and the third see no point of the first, so they come behind the last, although
    its angle is worse; the third comes before the second by its angle."""
    cameras = [frontal(80, 60, 80.0, (x, 0.0, 0.0)) for x in (0.0, 4.0, 0.3, 2.0)]
    black = np.zeros((60, 80, 3), np.float32)
    views = tuple(TrainingView(f"v{index}", camera, black) for index, camera in enumerate(cameras))
    tracks = [np.array(seen) for seen in ([0, 3], [0, 3], [1, 2])]
    points = cloud([(0.0, 0.0, 5.0), (0.1, 0.0, 5.0), (0.2, 0.0, 5.0)], views=tracks)
    given = TrainingSet(views, points)
    assert choose_sources(given, 3)[0] == [3, 2, 1]
    assert choose_sources(given, 1)[0] == [3]


@pytest.mark.parametrize("tracked", [True, False])
def test_the_sources_are_those_that_a_comparison_of_all_pairs_finds(tracked: bool) -> None:
    """Seven cameras beside each other before points of which each sees a part."""
    random = np.random.default_rng(4)
    cameras = [frontal(80, 60, 80.0, (0.5 * number, 0.0, 0.0)) for number in range(7)]
    xyz = np.stack([random.uniform(-3, 6, 400), random.uniform(-2, 2, 400), random.uniform(3, 9, 400)], 1)
    seen = np.stack([camera.inside(camera.project(xyz)[0]) for camera in cameras])
    if tracked:
        seen &= random.random(seen.shape) < 0.5
    black = np.zeros((60, 80, 3), np.float32)
    views = tuple(TrainingView(f"v{number}", camera, black) for number, camera in enumerate(cameras))
    points = cloud(xyz, views=[np.flatnonzero(column) for column in seen.T] if tracked else None)
    found = choose_sources(TrainingSet(views, points), 3)
    for one, camera in enumerate(cameras):
        worth = []
        for other, second in enumerate(cameras):
            common = xyz[seen[one] & seen[other]]
            directions = [(common - centre) for centre in (camera.centre, second.centre)]
            lengths = [np.linalg.norm(direction, axis=1) for direction in directions]
            cosine = (directions[0] * directions[1]).sum(axis=1) / (lengths[0] * lengths[1])
            angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            fair = np.minimum(angle / 3, 1) ** 2 * np.minimum(12 / np.maximum(angle, 1e-9), 1) ** 2
            worth.append(-1.0 if other == one else float(fair.sum()))
        assert found[one] == [int(other) for other in np.argsort(-np.array(worth), kind="stable")[:3]]


def test_planes_are_for_the_middle_of_how_far_places_of_the_picture_move() -> None:
    """Towards a camera in front places move apart, each differently. Independently: points at both ends of the range
    behind a grid of three by three places, projected."""
    camera, source = frontal(80, 60, 100.0), frontal(80, 60, 100.0, (0.1, 0.05, 0.7))
    low, high = 0.1, 0.6
    x, y = (places.ravel() for places in np.meshgrid([0.0, 40.0, 80.0], [0.0, 30.0, 60.0]))
    ends = []
    for disparity in (low, high):
        points = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(9)], axis=1) / disparity
        ends.append(source.project(points)[0])
    moved = np.median(np.linalg.norm(ends[0] - ends[1], axis=1))
    steps = math.ceil(moved / 0.75) + 1
    found = stereo._planes(camera, [source], low, high)
    assert steps > 16 and len(found) == -(-steps // 8) * 8


def test_coarser_scales_end_with_the_smallest_photograph() -> None:
    random = np.random.default_rng(0)
    views = []
    for name, width, height, x in (("a", 256, 192, 0.0), ("b", 96, 72, 0.2)):
        image = random.uniform(size=(height, width, 3)).astype(np.float32)
        views.append(TrainingView(name, frontal(width, height, 0.9 * width, (x, 0.0, 0.0)), image))
    points = cloud(np.stack([random.uniform(-1, 1, 40), random.uniform(-1, 1, 40), random.uniform(3, 6, 40)], axis=1))
    told: list[str] = []
    maps = stereo.stereo_depth(
        TrainingSet(tuple(views), points), coarser=9, progress=lambda what, done, of: told.append(what)
    )
    assert [one.depth.shape for one in maps] == [(192, 256), (72, 96)]
    assert not any("1/2" in what for what in told)  # the smaller photograph has no half that could be matched


def test_half_the_size_is_swept_by_half_as_many_planes(monkeypatch: pytest.MonkeyPatch) -> None:
    """More would find nothing more, and take longer."""
    random, counts, load = np.random.default_rng(0), [], stereo.load
    cameras = [frontal(256, 192, 240.0), frontal(256, 192, 240.0, (0.2, 0.0, 0.0))]

    def watched(op: str, *, function: str | None = None):
        run = load(op, function=function)

        def call(*arguments, **options):
            if function is None:
                counts.append(len(arguments[3]))
            return run(*arguments, **options)

        return call

    monkeypatch.setattr(stereo, "load", watched)
    levels = [stereo._pyramid(random.random((192, 256, 3)), camera, len(stereo.SCALES)) for camera in cameras]
    stereo._sweep(levels, 0, [1], 0.1, 0.6)
    assert len(counts) == len(levels[0]) > 1
    steps = counts[-1] - 1
    assert counts[::-1] == [math.ceil(steps / 2**level) + 1 for level in range(len(counts))]
