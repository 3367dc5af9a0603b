"""From the scene to a radiance field's unit cube.

Views in one direction share a frustum, in which places are in disparity, so that far things have no more cells than the
views resolve (NeRF's normalised device coordinates; Mildenhall et al., ECCV 2020, appendix C, here for any near and far
plane). Views from all around share all of space (`unbounded.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.runtime.device_numbers import beside
from dofbench.training.common.depth import all_disparities
from dofbench.training.fields.cube_rays import PER_RAY, CubeRays, Space
from dofbench.training.fields.unbounded import Unbounded

_LEAST_FORWARD = 0.5  # cosine of the angle between a frustum's axis and its widest rays
_POINTS_SHARE = 0.005  # of the sparse points that may be outliers, at each end
_NEARER, _FARTHER = 0.7, 0.7  # of the nearest points' distance from the cameras, and of the farthest points' disparity
_INFINITE = 0.02  # a far plane is at infinity if its disparity is less than this share of the near plane's
_MARGIN = 0.05  # of the extent of a frustum or a box, on each side


@dataclass(frozen=True, eq=False)
class Frustum:
    """The space before a reference camera: x / z and y / z from `low` to `high`, (2,), and disparity from `near` to
    `far`, 1 / scene unit. pose: (4, 4) world to reference camera. A place along a ray is its share of the way from near
    to far disparity."""

    pose: np.ndarray
    low: np.ndarray
    high: np.ndarray
    near: float
    far: float

    @property
    def has_surroundings(self) -> bool:
        return False

    @property
    def sampling(self) -> tuple[float, ...]:
        return (1.0,)

    def pieces(self, origins: Tensor, directions: Tensor) -> tuple[CubeRays, ...]:
        start, end = self._ends(*self._seen(origins, directions))
        ones = torch.ones_like(start[:, 0])
        directions = torch.cat([end - start, ones[:, None]], 1)
        spans = torch.stack([torch.zeros_like(ones), ones], 1)
        return (CubeRays(torch.cat([start, 0 * ones[:, None]], 1), directions, spans, PER_RAY * ones),)

    def depths(self, origins: Tensor, directions: Tensor, places: Tensor) -> Tensor:
        seen_from, along = self._seen(origins, directions)
        disparity = self.near + places * (self.far - self.near)
        z = 1 / disparity.clamp_min(_INFINITE * self.near / 100)
        return (z - seen_from[:, 2]) / along[:, 2]

    def nodes(self, most: int) -> tuple[int, int, int]:
        """As `Space.nodes`, along z half as many as along the longer side."""
        extent = self.high - self.low
        x, y = (max(2, round(most * float(side / extent.max()))) for side in extent)
        return x, y, max(2, most // 2)

    def record(self) -> dict[str, np.ndarray]:
        return {"pose": self.pose, "low": self.low, "high": self.high, "disparities": np.array([self.near, self.far])}

    def _seen(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        pose = beside(origins, self.pose)
        return origins @ pose[:3, :3].T + pose[:3, 3], directions @ pose[:3, :3].T

    def _ends(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        """(R, 2) each: x and y in the cube on the near and the far plane."""
        slope = directions[:, :2] / directions[:, 2:]
        low, extent = beside(origins, self.low), beside(origins, self.high - self.low)

        def at(disparity: float) -> Tensor:
            # x / z on the plane z = 1 / q is q o_x + (1 - q o_z) d_x / d_z, which holds at infinity too.
            place = origins[:, :2] * disparity + (1 - origins[:, 2:] * disparity) * slope
            return (place - low) / extent

        return at(self.near), at(self.far)


def space_of(record: dict[str, np.ndarray]) -> Space:
    """The space with this `record`. Raises KeyError for that of a field stored by a version without `Unbounded`."""
    if "pose" not in record:
        return Unbounded(record["box_low"], record["box_high"], float(record["near"]))
    near, far = (float(value) for value in record["disparities"])
    return Frustum(record["pose"], record["low"], record["high"], near, far)


def space_for(cameras: Sequence[Camera], points: np.ndarray, disparities: np.ndarray) -> Space:
    """A frustum if all cameras look in about one direction at points before all of them, else all of space.

    points: (P, 3), scene units. disparities: of any shape, 1 / scene unit, of the points over all cameras that see
    them.
    """
    pose = _mean_pose(cameras)
    centres = _transformed(pose, np.array([camera.centre for camera in cameras]))
    borders = [_transformed(pose, _border(camera)) for camera in cameras]
    rays = np.concatenate([border - centre for border, centre in zip(borders, centres, strict=True)])
    z = np.quantile(_transformed(pose, points)[:, 2], [_POINTS_SHARE, 1 - _POINTS_SHARE])
    forward = rays[:, 2] / np.linalg.norm(rays, axis=1)
    if forward.min() < _LEAST_FORWARD or z[0] <= centres[:, 2].max():
        low, high = np.quantile(points, [_POINTS_SHARE, 1 - _POINTS_SHARE], axis=0)
        return Unbounded(*_widened(low, high, _MARGIN), _NEARER * depth_at(disparities, 1 - _POINTS_SHARE))
    first = float(centres[:, 2].max())
    near = 1 / (first + _NEARER * (float(z[0]) - first))
    far = _FARTHER / float(z[1])
    far = far if far > _INFINITE * near else 0.0
    origins = np.repeat(centres, [len(border) for border in borders], axis=0)
    slope = rays[:, :2] / rays[:, 2:]
    ends = np.concatenate([origins[:, :2] * q + (1 - origins[:, 2:] * q) * slope for q in (near, far)])
    low, high = _widened(ends.min(axis=0), ends.max(axis=0), _MARGIN)
    return Frustum(pose, low, high, near, far)


def depth_at(disparities: np.ndarray, share: float) -> float:
    """The depth, scene units, beyond which this share of the disparities is; 0 if there are none."""
    return 1 / float(np.quantile(disparities, share)) if disparities.size else 0.0


def _widened(low: np.ndarray, high: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    margin = share * (high - low)
    return low - margin, high + margin


def _mean_pose(cameras: Sequence[Camera]) -> np.ndarray:
    """(4, 4) world to the camera at the mean centre, with the rotation nearest to the mean of the rotations."""
    left, _, right = np.linalg.svd(np.mean([camera.world_to_camera[:3, :3] for camera in cameras], axis=0))
    rotation = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ np.mean([camera.centre for camera in cameras], axis=0)
    return pose


def _transformed(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _border(camera: Camera) -> np.ndarray:
    """(8, 3) world points at depth 1 behind the image's corners and the middles of its sides."""
    ends = [(x, y) for x in (0, 0.5, 1) for y in (0, 0.5, 1) if (x, y) != (0.5, 0.5)]
    x, y = camera.rays(*(np.array(ends).T * [[camera.width], [camera.height]]))
    local = np.stack([x, y, np.ones_like(x)], axis=1)
    pose = camera.camera_to_world
    return local @ pose[:3, :3].T + pose[:3, 3]


_UNTIL = 0.256  # share of the training; RegNeRF 256 steps
_FIRST = 0.5  # of the way to the near plane, from the start; RegNeRF


@dataclass(frozen=True, eq=False)
class AnnealedSpace:
    """A space whose near plane comes closer during the training (RegNeRF; Niemeyer et al., CVPR 2022).

    Few cameras see what is right before one of them. In the first steps each camera's own image would be painted there,
    a haze that never goes away. whole: the final space. middle: the median depth of the points, scene units.
    """

    whole: Space
    middle: float

    @staticmethod
    def of(cameras: Sequence[Camera], points: PointCloud) -> AnnealedSpace:
        """See `space_for`."""
        disparities = all_disparities(points, cameras)
        return AnnealedSpace(space_for(cameras, points.xyz, disparities), depth_at(disparities, 0.5))

    def at(self, progress: float) -> Space:
        """The space at this share of the training. A frustum is whole from the start: its near plane is behind all
        cameras."""
        if not isinstance(self.whole, Unbounded):
            return self.whole
        share = min(max(progress / _UNTIL, _FIRST), 1)
        return replace(self.whole, near=self.middle + share * (self.whole.near - self.middle))
