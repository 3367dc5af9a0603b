"""Losses on surfaces and depth by hand, and the known depth of a view."""

import math
from itertools import product

import numpy as np
import pytest
import torch
from made_up import cloud, frontal
from tolerances import FLOAT32_SCALAR, PLANE_NORMAL

from dofbench.core.cameras import Camera
from dofbench.training.common.depth import SupervisionOptions, depth_loss, sparse_depth
from dofbench.training.common.depth_map import DepthMap, DepthSamples
from dofbench.training.common.losses import AdaptationOptions
from dofbench.training.gaussians.surface_losses import (
    DistortionOptions,
    NormalOptions,
    distortion_loss,
    normal_consistency,
    normals_from_depth,
)
from dofbench.training.gaussians.surface_terms import Distortion, Normals

CAMERA = Camera(24, 18, 20.0, 21.0, 12.5, 8.0, np.eye(4))


def _plane_depth(normal, offset):
    """Depth of the plane normal . x = offset at the pixel centres."""
    x = (np.arange(24) + 0.5 - CAMERA.cx) / CAMERA.fx
    y = (np.arange(18) + 0.5 - CAMERA.cy) / CAMERA.fy
    return torch.from_numpy(offset / (normal[0] * x + normal[1] * y[:, None] + normal[2]))


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.3, 0.1, -0.9), (-0.2, 0.4, -0.8)])
def test_normals_of_a_plane_are_its_normal(normal):
    unit = np.array(normal) / np.linalg.norm(normal)
    found = normals_from_depth(_plane_depth(unit, -5.0), CAMERA)
    assert np.allclose(found.numpy(), unit, atol=PLANE_NORMAL)


def test_normal_consistency_is_zero_when_splats_lie_in_the_surface():
    unit = np.array([0.3, 0.1, -0.9]) / np.linalg.norm([0.3, 0.1, -0.9])
    depth = _plane_depth(unit, -5.0)
    alpha = torch.full_like(depth, 0.8)
    normal = alpha[..., None] * torch.from_numpy(unit)
    aligned = normal_consistency(normal, alpha, depth, depth, CAMERA, 0.6)
    turned = normal_consistency(-normal, alpha, depth, depth, CAMERA, 0.6)
    assert float(aligned) == pytest.approx(0, abs=PLANE_NORMAL)
    assert float(turned) == pytest.approx(1.6)


def test_one_normal_a_pixel_is_compared_whatever_its_length():
    unit = np.array([0.3, 0.1, -0.9]) / np.linalg.norm([0.3, 0.1, -0.9])
    depth = _plane_depth(unit, -5.0)
    alpha = torch.full_like(depth, 0.8)
    alpha[:9] = 0
    normal = (0.3 * alpha[..., None] * torch.from_numpy(unit)).requires_grad_()
    loss = normal_consistency(normal, alpha, depth, depth, CAMERA, 0.6, "pixel")
    # Of 16 rows within the border, 8 have no surface, which counts as 1.
    assert float(loss.detach()) == pytest.approx(0.5)
    loss.backward()
    assert torch.isfinite(normal.grad).all() and not normal.grad[:9].any()


def test_distortion_loss_is_the_variance_of_mapped_depth():
    weights, depths = np.array([0.2, 0.3, 0.1]), np.array([1.0, 2.0, 5.0])
    near, far = 0.2, 100.0
    mapped = (far * depths - far * near) / ((far - near) * depths)
    pairs = sum(weights[i] * weights[j] * (mapped[i] - mapped[j]) ** 2 for i in range(3) for j in range(i))
    by_disparity = sum(
        weights[i] * weights[j] * (1 / depths[i] - 1 / depths[j]) ** 2 for i in range(3) for j in range(i)
    )
    distortion, alpha = torch.zeros(10, 12), torch.zeros(10, 12)
    distortion[4, 5], alpha[4, 5] = by_disparity, weights.sum()
    distortion.requires_grad_()
    loss = distortion_loss(distortion, alpha, torch.full((10, 12, 3), 0.4), near, far)
    assert float(loss) == pytest.approx(pairs / weights.sum() ** 2 / 120, rel=FLOAT32_SCALAR)
    assert float(loss) == pytest.approx(np.cov(mapped, aweights=weights, ddof=0) / 120, rel=FLOAT32_SCALAR)
    loss.backward()
    assert torch.isfinite(distortion.grad).all()


def test_distortion_counts_less_where_colour_jumps_and_not_at_the_border():
    image = torch.zeros(6, 8, 3)
    image[:, 4:] = torch.tensor([0.3, 0.6, 0.9])
    distortion = torch.ones(6, 8).requires_grad_()
    distortion_loss(distortion, torch.ones(6, 8), image, 0.2, 100.0).backward()
    weight = distortion.grad / distortion.grad.max()
    expected = torch.zeros(6, 8)
    expected[1:-1, 1:-1] = 1
    expected[1:-1, 3:5] = math.exp(-0.6)
    assert torch.allclose(weight, expected)


def test_the_two_readings_of_eq_13_weight_opposite_regions():
    x = torch.tensor([[0.0, 0.1], [0.6, 0.8]])
    printed = AdaptationOptions(adaptation="psi").loss_weight(x)
    text = AdaptationOptions(adaptation="one_minus_psi").loss_weight(x)
    assert AdaptationOptions(adaptation="off").loss_weight(x) is None
    assert bool((printed[1] > printed[0]).all()) and bool((text[1] < text[0]).all())


@pytest.mark.parametrize(
    ("norm", "space", "expected"),
    [
        ("l1", "depth", (1.0 + 3.0) / 2),
        ("l2", "depth", math.sqrt((1 + 9) / 2)),
        ("l1", "disparity", (abs(1 / 3 - 1 / 2) + abs(1 / 5 - 1 / 2)) / 2 / 0.5),
    ],
)
def test_depth_loss_by_hand(norm, space, expected):
    depth = torch.full((4, 4), 2.0)
    depth[1, 2], depth[3, 0] = 3.0, 5.0
    truth = DepthSamples(torch.tensor([1, 3]), torch.tensor([2, 0]), torch.tensor([2.0, 2.0]))
    options = SupervisionOptions(depth_norm=norm, depth_space=space)
    loss = depth_loss(depth, torch.ones(4, 4), truth, options, 0.5, None)
    assert float(loss) == pytest.approx(expected, rel=FLOAT32_SCALAR)


def test_sparse_depth_says_nothing_where_there_is_no_surface():
    """One of three known pixels has a surface, one is transparent, and one shows nothing at all: depth 0."""
    depth = torch.full((4, 4), 2.0)
    depth[1, 2], depth[3, 3] = 3.0, 0.0
    alpha = torch.zeros(4, 4)
    alpha[1, 2], alpha[0, 0] = 1.0, 0.05
    truth = DepthSamples(torch.tensor([1, 0, 3]), torch.tensor([2, 0, 3]), torch.tensor([2.0, 7.0, 4.0]))
    for norm, space in product(("l1", "l2"), ("depth", "disparity")):
        options, rendered = SupervisionOptions(depth_norm=norm, depth_space=space), depth.clone().requires_grad_()
        loss = depth_loss(rendered, alpha, truth, options, 1.0, None)
        assert float(loss) == pytest.approx(1.0 if space == "depth" else 1 / 2 - 1 / 3, rel=FLOAT32_SCALAR)
        (gradient,) = torch.autograd.grad(loss, rendered)
        assert (gradient != 0).nonzero().tolist() == [[1, 2]] and bool(gradient.isfinite().all())
        nothing = depth_loss(rendered, torch.zeros(4, 4), truth, options, 1.0, None)
        assert not torch.autograd.grad(nothing, rendered)[0].any()


def test_depth_counts_by_its_confidence_and_by_the_adaptation():
    """Differences 1 and 3 of confidence 0.2 and 0.6, that is 1/2 and 3/2 of their mean, and adaptation 1 and 1/4."""
    depth = torch.full((4, 4), 2.0)
    depth[1, 2], depth[3, 0] = 3.0, 5.0
    rows, columns = torch.tensor([1, 3]), torch.tensor([2, 0])
    truth = DepthSamples(rows, columns, torch.tensor([2.0, 2.0]), torch.tensor([0.2, 0.6]))
    weight = torch.ones(4, 4)
    weight[3, 0] = 0.25

    def loss(adaptation, norm):
        options = SupervisionOptions(depth_norm=norm)
        return float(depth_loss(depth, torch.ones(4, 4), truth, options, 0.5, adaptation))

    assert loss(None, "l1") == pytest.approx((1 * 0.5 + 3 * 1.5) / 2, rel=FLOAT32_SCALAR)
    assert loss(weight, "l1") == pytest.approx((1 * 0.5 + 3 * 1.5 / 4) / 2, rel=FLOAT32_SCALAR)
    assert loss(weight, "l2") == pytest.approx(math.sqrt((1 * 0.5 + 9 * 1.5 / 4) / 2), rel=FLOAT32_SCALAR)


def test_normals_and_distortion_act_from_their_share_of_the_training_on():
    normals = Normals(NormalOptions(normal_from=0.4))
    distortion = Distortion(DistortionOptions(distortion_weight=1.0, distortion_from=0.4))
    for term in (normals, distortion):
        assert [term.acts(1, progress, None) for progress in (0.0, 0.39, 0.4, 1.0)] == [False, False, True, True]


SEEN_FROM = frontal(100, 80, 90.0)


def _on_grid(depth, pixels):
    return [((u - 50) / 90 * depth, (v - 40) / 90 * depth, depth) for u, v in pixels]


def test_tracks_decide_where_they_are_known():
    xyz = _on_grid(5.0, [(10.5, 10.5), (60.5, 30.5), (90.5, 70.5)])
    tracks = (np.array([0, 1]), np.array([1]), np.array([0]))
    found = sparse_depth(cloud(xyz, tracks), SEEN_FROM, 0)
    assert found.columns.tolist() == [10, 90] and found.rows.tolist() == [10, 70]
    assert np.allclose(found.depth, 5.0)


def test_points_behind_the_camera_and_outside_the_image_are_left_out():
    xyz = [(0, 0, -3.0), (100.0, 0, 5.0), (0, 0, 5.0)]
    found = sparse_depth(cloud(xyz), SEEN_FROM, 0)
    assert found.columns.tolist() == [50] and found.rows.tolist() == [40]


def test_without_tracks_points_behind_a_surface_are_left_out():
    grid = [(u + 0.5, v + 0.5) for u in range(40, 60, 2) for v in range(30, 50, 2)]
    front = _on_grid(4.0, grid)
    behind = _on_grid(9.0, [(50.2, 40.2), (45.2, 36.2)])
    elsewhere = _on_grid(9.0, [(u + 0.5, 70.5) for u in range(5, 95, 3)])
    found = sparse_depth(cloud(front + behind + elsewhere), SEEN_FROM, 0)
    assert len(found.depth) == len(front) + len(elsewhere)
    assert int((found.depth > 5).sum()) == len(elsewhere)


def test_samples_are_put_into_a_copy_of_a_depth_map() -> None:
    before = DepthMap(np.full((2, 3), 4.0, np.float32), np.full((2, 3), 0.5, np.float32))
    where = torch.tensor([1]), torch.tensor([2])
    after = before.with_samples(DepthSamples(*where, torch.tensor([7.0])))
    assert (before.depth == 4.0).all() and (before.weight == 0.5).all()
    assert after.depth.tolist() == [[4, 4, 4], [4, 4, 7]] and after.weight.tolist() == [[0.5] * 3, [0.5, 0.5, 1.0]]


def test_samples_on_a_device_are_in_the_order_of_their_pixels_with_what_belongs_to_them() -> None:
    """And how many lie in one pixel at most is told, by which a GPU adds up their gradients."""
    rows, columns = torch.tensor([2, 0, 2, 1, 2, 0]), torch.tensor([1, 5, 1, 0, 0, 5])
    number = torch.arange(6, dtype=torch.float32)
    found = DepthSamples(rows, columns, 1 + number, number).on("cpu")
    assert list(zip(found.rows.tolist(), found.columns.tolist(), strict=True)) == [
        (0, 5), (0, 5), (1, 0), (2, 0), (2, 1), (2, 1),
    ]  # fmt: skip
    assert found.weight is not None and found.weight.tolist() == [1, 5, 3, 4, 0, 2]
    assert torch.equal(found.depth, 1 + found.weight) and found.most == 2
    nothing = DepthSamples(rows[:0], columns[:0], number[:0]).on("cpu")
    assert len(nothing.depth) == 0 and nothing.most == 1 and nothing.weight is None
