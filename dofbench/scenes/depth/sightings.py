"""Structure-from-motion points seen in each view: image position, disparity, weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.scenes.scene import Scene
from dofbench.scenes.visibility import hidden

# A reprojection error this many times the scene's median speaks of a wrong match.
_WORST_ERROR = 4.0
# A sighting that agrees with none of its nearest neighbours, to this share of the disparities' range, stands alone.
_NEIGHBOURS, _AGREEMENT = 8, 0.15
# Reprojection error at which a sighting weighs half of what an exact one does, as a multiple of the scene's median.
_HALF_WEIGHT = 1.0
# Disparities below this share of the points' 1st percentile are raised to it, and those above so many times their 99th
# are cut: nothing is nearly so far, or so near.
_FLOOR_SHARE, _CEILING_SHARE = 0.1, 10.0
CLIPPED = (
    f"share of disparities below {_FLOOR_SHARE:g} of the points' 1st percentile, which were raised to it, or above "
    f"{_CEILING_SHARE:g} times their 99th, which were cut"
)


@dataclass(frozen=True, eq=False)
class Sightings:
    """xy: (M, 2) image coordinates, pixels. disparity: (M,) 1 / scene unit. weight: (M,), 0 ... 1.

    rejected: number of sightings that were excluded as outliers.
    """

    xy: np.ndarray
    disparity: np.ndarray
    weight: np.ndarray
    rejected: int

    def __len__(self) -> int:
        return len(self.disparity)

    def scaled(self, factor_x: float, factor_y: float) -> Sightings:
        """The same sightings in an image resized by the factors."""
        return Sightings(self.xy * (factor_x, factor_y), self.disparity, self.weight, self.rejected)


@dataclass(frozen=True, eq=False)
class SceneSightings:
    """Sightings of all views, by view name. extent: of the disparities, 5th to 95th percentile. floor, ceiling: bounds
    of estimated disparity. All 1 / scene unit."""

    by_view: dict[str, Sightings]
    extent: float
    floor: float
    ceiling: float


def scene_sightings(scene: Scene, need: str) -> SceneSightings:
    """The points seen in each view, by track or else inside the image and not `hidden`, without outliers.

    need: what they are for. Raises InputError when the scene has no points, or no sighting inside any image.
    """
    points = scene.require_points(need)
    known = points.error[np.isfinite(points.error)]
    usual = float(np.median(known)) if known.size else 0.0
    by_view = {view.name: _of_view(points, view.camera, index, usual) for index, view in enumerate(scene.views)}
    disparity = np.concatenate([found.disparity for found in by_view.values()])
    if disparity.size == 0:
        raise InputError(scene.root, "no sparse point that any view sees", f"some for {need}")
    least, low, high, most = (float(value) for value in np.percentile(disparity, [1, 5, 95, 99]))
    return SceneSightings(by_view, max(high - low, 1e-3 * high), _FLOOR_SHARE * least, _CEILING_SHARE * most)


def _of_view(points: PointCloud, camera: Camera, view: int, usual: float) -> Sightings:
    chosen = np.arange(len(points)) if points.views is None else points.seen_from(view)
    xy, depth = camera.project(points.xyz[chosen])
    inside = camera.inside(xy)
    if points.views is None:
        inside[inside] = ~hidden(xy[inside], depth[inside], camera.width)
    error = np.nan_to_num(points.error[chosen].astype(np.float64), nan=usual)
    xy, disparity, error = xy[inside], 1.0 / depth[inside], error[inside]
    good = (error <= _WORST_ERROR * usual) if usual > 0 else np.ones(len(error), dtype=bool)
    good &= ~_alone(xy, disparity)
    weight = 1.0 / (1.0 + (error / (_HALF_WEIGHT * usual)) ** 2) if usual > 0 else np.ones(len(error))
    return Sightings(xy[good], disparity[good], weight[good], int((~good).sum()))


def _alone(xy: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Sightings (M,) bool whose disparity no neighbour in the image comes near."""
    if len(disparity) <= _NEIGHBOURS:
        return np.zeros(len(disparity), dtype=bool)
    from scipy.spatial import cKDTree

    _, index = cKDTree(xy).query(xy, k=_NEIGHBOURS + 1)
    low, high = np.percentile(disparity, [5, 95])
    nearest = np.abs(disparity[index[:, 1:]] - disparity[:, None]).min(axis=1)
    return nearest > _AGREEMENT * (high - low) + 1e-9 * high
