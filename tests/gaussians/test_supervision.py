import numpy as np
import torch
from made_up import cloud, frontal

from dofbench.training.common.depth import DepthMap, DepthSamples, sparse_depth

CAMERA = frontal(100, 80, 90.0)


def _on_grid(depth, pixels):
    return [((u - 50) / 90 * depth, (v - 40) / 90 * depth, depth) for u, v in pixels]


def test_tracks_decide_where_they_are_known():
    xyz = _on_grid(5.0, [(10.5, 10.5), (60.5, 30.5), (90.5, 70.5)])
    tracks = (np.array([0, 1]), np.array([1]), np.array([0]))
    found = sparse_depth(cloud(xyz, tracks), CAMERA, 0)
    assert found.columns.tolist() == [10, 90] and found.rows.tolist() == [10, 70]
    assert np.allclose(found.depth, 5.0)


def test_points_behind_the_camera_and_outside_the_image_are_left_out():
    xyz = [(0, 0, -3.0), (100.0, 0, 5.0), (0, 0, 5.0)]
    found = sparse_depth(cloud(xyz), CAMERA, 0)
    assert found.columns.tolist() == [50] and found.rows.tolist() == [40]


def test_without_tracks_points_behind_a_surface_are_left_out():
    grid = [(u + 0.5, v + 0.5) for u in range(40, 60, 2) for v in range(30, 50, 2)]
    front = _on_grid(4.0, grid)
    behind = _on_grid(9.0, [(50.2, 40.2), (45.2, 36.2)])
    elsewhere = _on_grid(9.0, [(u + 0.5, 70.5) for u in range(5, 95, 3)])
    found = sparse_depth(cloud(front + behind + elsewhere), CAMERA, 0)
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
