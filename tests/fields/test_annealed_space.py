"""Where rays begin while training begins."""

from __future__ import annotations

import numpy as np
import pytest
from made_up import cloud, frontal
from tolerances import FLOAT32_VALUE

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.training.fields.space import AnnealedSpace
from dofbench.training.fields.unbounded import Unbounded


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
