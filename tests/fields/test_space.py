"""From the scene to the unit cube and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from made_up import cloud, frontal
from tolerances import FLOAT32_VALUE, FLOAT64_VALUE, SEARCHED_PLACE

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.training.fields.cube_rays import Space
from dofbench.training.fields.pixels import CameraTable, whole_image
from dofbench.training.fields.space import AnnealedSpace, Frustum, space_for, space_of
from dofbench.training.fields.unbounded import Unbounded

PLACES = [(-0.3, 0.1, 0.2), (0.4, 0.0, -0.1), (0.0, -0.3, 0.0)]
NEAREST, FARTHEST = 2.0, 8.0
UNSEEN = np.array([])  # disparities of no point at all


def frontal_cameras() -> list[Camera]:
    return [frontal(40, 30, 45.0, place) for place in PLACES]


def points(farthest: float = FARTHEST, moved: float = 0.0) -> np.ndarray:
    """(P, 3), in what the cameras see, or that by so much farther away."""
    random = np.random.default_rng(0)
    z = 1 / random.uniform(1 / farthest, 1 / NEAREST, 4000)
    return np.stack([random.uniform(-0.4, 0.4, 4000) * z, random.uniform(-0.3, 0.3, 4000) * z, z + moved], axis=1)


def around(count: int = 6) -> list[Camera]:
    """Cameras on a circle of radius 4 that look at its centre."""
    cameras = []
    for angle in 2 * math.pi * np.arange(count) / count:
        pose = np.eye(4)
        pose[:3, :3] = [[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]]
        pose[2, 3] = 4.0
        cameras.append(Camera(40, 30, 45.0, 45.0, 20.0, 15.0, pose))
    return cameras


def frustum(farthest: float = FARTHEST) -> Space:
    found = space_for(frontal_cameras(), points(farthest), UNSEEN)
    assert isinstance(found, Frustum)
    return found


def ball(radius: float) -> np.ndarray:
    random = np.random.default_rng(1)
    directions = random.normal(size=(4000, 3))
    return radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def rays(cameras: list[Camera], view: int, pixels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    views = torch.full((len(pixels),), view)
    origins, directions = CameraTable(cameras).rays(views, pixels)
    return origins.double(), directions.double()


def in_cube(space: Space, cameras: list[Camera], point: np.ndarray, view: int) -> tuple[torch.Tensor, float, float]:
    """(where the ray of a view to a world point has it in the cube, its place on the ray, its depth)."""
    xy, depth = cameras[view].project(point[None])
    origins, directions = rays(cameras, view, torch.from_numpy(xy).float())
    directions = torch.from_numpy(point[None] - origins.numpy()) / depth[0]  # without float32's rounding of the pixel
    (cube,) = space.pieces(origins, directions)
    places = torch.linspace(0, 1, 100001, dtype=torch.float64)
    found = space.depths(origins.expand(len(places), 3), directions.expand(len(places), 3), places)
    place = float(places[(found - depth[0]).abs().argmin()])
    return (cube.origins + place * cube.directions)[0], place, float(depth[0])


@pytest.mark.parametrize("farthest", [FARTHEST, 1e5])
@given(x=st.floats(-0.25, 0.25), y=st.floats(-0.2, 0.2), part=st.floats(0, 1))
def test_a_point_has_one_place_in_the_frustum_whoever_sees_it(farthest: float, x: float, y: float, part: float) -> None:
    z = 1 / (1 / NEAREST + part * (1 / 8 - 1 / NEAREST))
    space, point = frustum(farthest), np.array([x * z, y * z, z])
    seen = [in_cube(space, frontal_cameras(), point, view)[0] for view in range(len(PLACES))]
    for other in seen[1:]:
        torch.testing.assert_close(other, seen[0], rtol=0, atol=SEARCHED_PLACE)
    assert all(0 <= float(value) <= 1 for value in seen[0])


def test_all_pixels_are_inside_at_both_ends() -> None:
    cameras, space = frontal_cameras(), frustum()
    for view, camera in enumerate(cameras):
        (cube,) = space.pieces(*rays(cameras, view, whole_image(camera)))
        ends = cube.origins + cube.spans[:, 1:] * cube.directions
        for end in (cube.origins, ends):
            assert float(end.min()) >= 0 and float(end.max()) <= 1
        assert (cube.origins[:, 2] == 0).all() and (ends[:, 2] == 1).all()


def test_the_near_plane_lies_before_all_points_and_behind_all_cameras() -> None:
    space = frustum()
    assert isinstance(space, Frustum)
    at = space.pose[2, :3] @ np.array(PLACES).T + space.pose[2, 3]
    seen = points() @ space.pose[2, :3] + space.pose[2, 3]
    assert at.max() < 1 / space.near < seen.min() and 0 < space.far < 1 / seen.max()


def test_points_at_infinity_put_the_far_plane_there() -> None:
    space = frustum(1e6)
    assert isinstance(space, Frustum) and space.far == 0
    (cube,) = space.pieces(*rays(frontal_cameras(), 0, torch.tensor([[20.0, 15.0]])))
    depth = space.depths(*rays(frontal_cameras(), 0, torch.tensor([[20.0, 15.0]])), torch.ones(1).double())
    assert bool(torch.isfinite(cube.directions).all()) and 1e3 < float(depth) < math.inf


def test_cameras_that_look_around_or_stand_among_the_points_share_all_of_space() -> None:
    assert isinstance(space_for(around(), ball(1.0), UNSEEN), Unbounded)
    assert isinstance(space_for(frontal_cameras(), points(moved=-4.0), UNSEEN), Unbounded)


def test_what_is_seen_from_around_begins_before_the_nearest_points() -> None:
    """Of points at depths from 3 to 5 few are outliers; cameras that see none leave nothing out."""
    space = space_for(around(), ball(1.0), 1 / np.array([0.1, *np.linspace(3, 5, 999)]))
    assert isinstance(space, Unbounded) and 0.5 * 3 < space.near < 0.9 * 3
    blind = space_for(around(), ball(1.0), UNSEEN)
    assert isinstance(blind, Unbounded) and blind.near == 0


def test_gradients_reach_the_rays() -> None:
    space = frustum()
    origins, directions = (one.requires_grad_() for one in rays(frontal_cameras(), 0, torch.tensor([[21.0, 14.0]])))

    def mapped(o: torch.Tensor, d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        (cube,) = space.pieces(o, d)
        return cube.origins, cube.directions

    assert torch.autograd.gradcheck(mapped, (origins, directions))


def test_the_record_gives_the_space_back() -> None:
    for space, cameras in (
        (frustum(), frontal_cameras()),
        (space_for(around(), ball(1.0), 1 / np.array([3.0])), around()),
    ):
        again = space_of(space.record())
        ray = rays(cameras, 1, torch.tensor([[3.0, 4.0]]))
        for one, other in zip(space.pieces(*ray), again.pieces(*ray), strict=True):
            for name in ("origins", "directions", "spans", "gain"):
                torch.testing.assert_close(getattr(one, name), getattr(other, name), rtol=FLOAT64_VALUE, atol=0)


def test_nodes_follow_the_sides() -> None:
    assert Frustum(np.eye(4), np.zeros(2), np.array([2.0, 1.0]), 1.0, 0.1).nodes(100) == (100, 50, 50)


def line() -> PointCloud:
    """Points ahead of a camera, at depths from 2 to 8 in even steps, and one behind it."""
    z = np.linspace(2, 8, 601)
    xyz = [*np.stack([0 * z, 0 * z, z], 1).tolist(), [0.0, 0.0, -3.0]]
    return cloud(xyz, views=[np.array([0, 1])] * 601 + [np.array([], int)])


def cameras() -> list[Camera]:
    """Two that look ahead, and one between the points that sees none of them."""
    turned = frontal(40, 30, 45.0)
    aside = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return [
        frontal(40, 30, 45.0),
        frontal(40, 30, 45.0),
        Camera(40, 30, 45.0, 45.0, 20.0, 15.0, aside @ turned.world_to_camera),
    ]


def near(space: AnnealedSpace, progress: float) -> float:
    found = space.at(progress)
    assert isinstance(found, Unbounded)
    return found.near


def test_rays_begin_half_way_from_the_middle_and_then_come_nearer() -> None:
    """Until 256 of 1000 steps."""
    space = AnnealedSpace.of(cameras(), line())
    last = near(space, 0.256)
    assert 1.2 < last < 2.0  # before the nearest point
    assert near(space, 0) == near(space, 0.128) == pytest.approx((5 + last) / 2, rel=FLOAT32_VALUE)
    assert near(space, 0.192) == pytest.approx(last + (5 - last) / 4, rel=FLOAT32_VALUE)
    assert near(space, 0.9) == last
    at_first, whole = space.at(0).record(), space.whole.record()
    assert all((at_first[name] == whole[name]).all() for name in whole if name != "near")


def test_a_frustum_is_there_from_the_start() -> None:
    space = AnnealedSpace.of(
        [frontal(40, 30, 45.0), frontal(40, 30, 45.0, (0.1, 0, 0))], cloud(line().xyz[:-1], views=line().views[:-1])
    )
    assert not isinstance(space.whole, Unbounded) and space.at(0) is space.whole


def test_cameras_that_see_nothing_leave_nothing_out() -> None:
    unseen = cloud(line().xyz, views=[np.array([], int)] * 602)
    space = AnnealedSpace.of(cameras(), unseen)
    assert near(space, 0) == near(space, 0.256) == 0
