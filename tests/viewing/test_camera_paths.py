"""Camera paths: they pass what they say, stay rigid, and keep what they are to keep."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tolerances import FLOAT64_VALUE

from dofbench.core.cameras import Camera
from dofbench.viewing import camera_paths as paths

BASE = Camera(96, 64, 80.0, 80.0, 48.0, 32.0, np.eye(4))
UP = np.array([0.0, -1.0, 0.0])
TARGET = np.array([0.2, 0.1, 4.0])


def ring(count: int) -> list[Camera]:
    """Cameras around a target, at two heights, that look at it."""
    angles = np.linspace(0, 2 * math.pi, count, endpoint=False)
    places = [TARGET + [3 * math.cos(a), 0.4 * (-1) ** i, 3 * math.sin(a)] for i, a in enumerate(angles)]
    return [paths.looking_at(BASE, np.array(place), TARGET, UP) for place in places]


def is_rigid(camera: Camera) -> bool:
    rotation = camera.world_to_camera[:3, :3]
    return bool(np.abs(rotation @ rotation.T - np.eye(3)).max() < FLOAT64_VALUE and np.linalg.det(rotation) > 0)


@given(st.integers(2, 9), st.booleans())
def test_a_path_along_cameras_passes_each_of_them(count: int, straight: bool) -> None:
    cameras = ring(count)
    moments = np.linspace(0, 1, count)
    path = paths.along(cameras, moments, straight=straight)
    for moment, camera in zip(moments, cameras, strict=True):
        assert np.abs(path(moment).world_to_camera - camera.world_to_camera).max() < FLOAT64_VALUE
    assert all(is_rigid(path(moment)) for moment in np.linspace(0, 1, 20))


def test_without_moments_the_speed_is_even() -> None:
    places = np.array([0.0, 0.1, 1.0, 3.0])  # on a line
    cameras = [paths.looking_at(BASE, np.array([x, 0, 0]), np.array([x, 0, 9.0]), UP) for x in places]
    path = paths.along(cameras, straight=True)
    found = [path(moment).centre[0] for moment in np.linspace(0, 1, 11)]
    assert found == pytest.approx(np.linspace(0, 3, 11), abs=FLOAT64_VALUE)


def test_a_zoom_between_cameras_is_even_in_proportion_and_does_not_overshoot() -> None:
    from dataclasses import replace

    cameras = [BASE, BASE, replace(BASE, fx=320.0, fy=320.0), replace(BASE, fx=320.0, fy=320.0)]
    found = [paths.along(cameras, [0, 0.3, 0.7, 1.0])(moment).fx for moment in np.linspace(0, 1, 41)]
    assert min(found) >= 80 - FLOAT64_VALUE and max(found) <= 320 + 1e3 * FLOAT64_VALUE
    assert paths.along(cameras, [0, 0.3, 0.7, 1.0])(0.5).fx == pytest.approx(160.0)


@pytest.mark.parametrize("moments", [[0, 0.5], [0, 0.5, 0.4], [0.1, 0.5, 1], [0, 0.5, 0.9]])
def test_other_moments_are_refused(moments: list[float]) -> None:
    with pytest.raises(ValueError, match="moments"):
        paths.along(ring(3), moments)


def test_a_spiral_looks_at_one_point_and_closes() -> None:
    cameras = ring(12)[:3]
    path = paths.spiral(cameras, 3.0, turns=2)
    middle = paths.mean_camera(cameras)
    target = middle.centre + 3.0 * middle.camera_to_world[:3, 2]
    for moment in np.linspace(0, 1, 13):
        xy, depth = path(moment).project(target[None])
        assert xy[0] == pytest.approx([48, 32], abs=1e3 * FLOAT64_VALUE) and depth[0] > 0 and is_rigid(path(moment))
    assert np.abs(path(0).world_to_camera - path(1).world_to_camera).max() < FLOAT64_VALUE
    ways = [np.linalg.norm(path(m).centre - middle.centre) for m in np.linspace(0, 1, 50)]
    assert 0 < max(ways) < 3 * np.ptp([camera.centre for camera in cameras], axis=0).max()


def test_an_orbit_keeps_its_distance_and_looks_at_the_middle() -> None:
    cameras = ring(8)
    assert paths.looked_at(cameras) == pytest.approx(TARGET, abs=FLOAT64_VALUE)
    path = paths.orbit(cameras)
    for moment in np.linspace(0, 1, 9):
        camera = path(moment)
        xy, depth = camera.project(TARGET[None])
        assert xy[0] == pytest.approx([48, 32], abs=1e3 * FLOAT64_VALUE)
        assert depth[0] == pytest.approx(3.0, abs=10 * FLOAT64_VALUE)  # at their mean height, which is the target's
    assert path(0).centre == pytest.approx(path(1).centre, abs=FLOAT64_VALUE)
    assert np.linalg.norm(path(0).centre - cameras[0].centre) < 0.5
    other = paths.orbit(cameras, turns=-0.25)(1).centre
    assert other == pytest.approx(path(0.75).centre, abs=FLOAT64_VALUE)


@given(st.floats(-3, 3), st.floats(3.5, 9), st.floats(0, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_a_dolly_zoom_keeps_the_size_of_what_is_at_the_depth(
    way: float, depth: float, moment: float, x: float, y: float
) -> None:
    camera = ring(5)[2]
    local = np.array([x, y, depth, 1.0])
    point = (camera.camera_to_world @ local)[:3]
    before, _ = camera.project(point[None])
    after, _ = paths.dolly(camera, way, held_depth=depth)(moment).project(point[None])
    assert after[0] == pytest.approx(before[0], abs=1e3 * FLOAT64_VALUE)
    plain = paths.dolly(camera, way)(moment)
    assert plain.fx == camera.fx and np.linalg.norm(plain.centre - camera.centre) == pytest.approx(abs(way) * moment)


def test_a_dolly_zoom_into_the_plane_is_refused() -> None:
    with pytest.raises(ValueError, match="held_depth"):
        paths.dolly(BASE, 3.0, held_depth=2.0)
    with pytest.raises(ValueError, match="looking_at"):
        paths.looking_at(BASE, TARGET, TARGET, UP)
    with pytest.raises(ValueError, match="at least one"):
        paths.along([])


@given(st.integers(2, 4000), st.integers(10, 3000), st.integers(10, 3000))
def test_a_size_is_even_and_has_the_cameras_proportions(width: int, wide: int, high: int) -> None:
    camera = paths.resized_to(Camera(wide, high, 50.0, 50.0, wide / 2, high / 2, np.eye(4)), width)
    assert camera.width % 2 == camera.height % 2 == 0 and 0 <= width - camera.width <= 1
    assert abs(camera.height - high * camera.width / wide) <= 1 or camera.height == 2
