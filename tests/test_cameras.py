"""Camera: projection, resizing, the frame's direction."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera


def camera(seed: int = 0, width: int = 64, height: int = 48) -> Camera:
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation * np.linalg.det(rotation), rng.normal(size=3)
    return Camera(width, height, *rng.uniform(30, 90, 2), *rng.uniform(20, 40, 2), pose)


def in_front(view: Camera, count: int = 30, seed: int = 1) -> np.ndarray:
    """World points before the camera."""
    rng = np.random.default_rng(seed)
    local = np.column_stack([rng.normal(size=(count, 2)), rng.uniform(0.5, 9, count)])
    return local @ view.camera_to_world[:3, :3].T + view.centre


@given(st.integers(0, 10_000))
def test_inverse_and_centre(seed):
    view = camera(seed)
    np.testing.assert_allclose(view.camera_to_world, np.linalg.inv(view.world_to_camera), atol=FLOAT64_VALUE)
    np.testing.assert_allclose(view.world_to_camera @ np.append(view.centre, 1), [0, 0, 0, 1], atol=FLOAT64_VALUE)


@given(st.integers(0, 10_000))
def test_projection_is_the_calibration_matrix(seed):
    view = camera(seed)
    points = in_front(view)
    pixels, depth = view.project(points)
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ (view.intrinsics @ view.world_to_camera[:3]).T
    np.testing.assert_allclose(depth, homogeneous[:, 2], atol=FLOAT64_VALUE)
    np.testing.assert_allclose(pixels, homogeneous[:, :2] / homogeneous[:, 2:], rtol=FLOAT64_VALUE)


def test_axes():
    view = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    pixels, depth = view.project(np.array([[0.0, 0, 2], [1, 0, 2], [0, 1, 2]]))
    assert pixels.tolist() == [[32, 24], [57, 24], [32, 49]] and depth.tolist() == [2, 2, 2]


def test_behind_the_camera_is_nowhere():
    view = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    pixels, depth = view.project(np.array([[0.0, 0, -2], [1, 1, 0], [0, 0, 1]]))
    assert np.isnan(pixels[:2]).all() and np.isfinite(pixels[2]).all()
    assert depth.tolist() == [-2, 0, 1]


@given(st.integers(0, 1000), st.integers(1, 300), st.integers(1, 300))
def test_resizing_moves_points_with_the_pixels(seed, width, height):
    view = camera(seed)
    small = view.resized(width, height)
    before, after = view.project(in_front(view))[0], small.project(in_front(view))[0]
    np.testing.assert_allclose(after, before * (width / 64, height / 48), rtol=FLOAT64_VALUE)
    assert (small.width, small.height) == (width, height)
    again = small.resized(64, 48)
    assert (again.fx, again.cy) == pytest.approx((view.fx, view.cy))


def test_a_camera_is_its_own_and_cannot_be_changed():
    pose = np.eye(4)
    view = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, pose)
    pose[0, 3] = 5.0
    assert view.world_to_camera[0, 3] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        view.world_to_camera[0, 3] = 1.0
    with pytest.raises(ValueError, match=r"expected shape \(4, 4\), found \(3, 4\)"):
        Camera(64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)[:3])


@given(st.integers(0, 1000))
def test_a_ray_is_what_its_pixel_sees(seed):
    view = camera(seed)
    x, y = view.rays(*view.pixels(np.array([0.3, -1.0]), np.array([0.1, 2.0]), np.array([2.0, 5.0])))
    np.testing.assert_allclose(x, [0.15, -0.2], atol=FLOAT64_VALUE)
    np.testing.assert_allclose(y, [0.05, 0.4], atol=FLOAT64_VALUE)


def test_binning_makes_a_pixel_of_every_whole_cell():
    view = camera(width=65, height=49)
    coarse = view.binned(4)
    assert (coarse.width, coarse.height) == (16, 12)
    points = in_front(view)
    np.testing.assert_allclose(coarse.project(points)[0] * 4, view.project(points)[0], rtol=FLOAT64_VALUE)
    assert coarse.world_to_camera.tolist() == view.world_to_camera.tolist()


def test_inside_are_the_coordinates_of_pixels():
    view = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    xy = np.array([[0.0, 0.0], [63.9, 47.9], [64.0, 5.0], [5.0, 48.0], [-0.1, 5.0], [np.nan, np.nan]])
    assert view.inside(xy).tolist() == [True, True, False, False, False, False]
