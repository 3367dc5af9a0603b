"""Reprojection consistency of every view's depth with a few neighbours.

A pixel is lifted by its depth and projected into the neighbour, where both disparities should be equal. Where the
neighbour's is nearer, it is an occluder if, projected back, it agrees with the first view; then the pixel is ignored.
Otherwise the views contradict each other, so that depth off by a factor doesn't pass for hidden.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.lens import COC_FRACTION, DisparityRange
from dofbench.runtime.view_threads import over_views

NEIGHBOURS = 4
_PIXELS = 5_000  # of a view at most that are compared with each neighbour, on a regular grid
AGREEMENT = 0.05  # relative difference of disparity up to which two views agree
# Pixels that a point is moved by before its pixel is taken. Where cameras and surfaces stand in round numbers, points
# fall on borders of pixels, and the last bit of a sum, which isn't the same everywhere, would choose the side.
_BORDER = 1e-6
_NOISE = 9  # decimals beyond which distances and differences are equal
_LEAST = 0.02  # share of the pixels that must be comparable for a pair to say anything
# A view is called inconsistent when its difference is large in itself, or when its difference or its share of
# disagreeing pixels is far above those of the other views.
WORST, PEERS = 0.2, 4.0
UNREMARKABLE, UNREMARKABLE_SHARE = 0.02, 0.1


@dataclass(frozen=True)
class Consistency:
    """Agreement of a view's depth with the median neighbour's (by difference), so that a wrong neighbour counts little.

    compared: share of the view's known pixels on known, unhidden depth of the neighbour. consistent: share of those
    whose disparities differ by at most 5 %. difference: median relative difference of disparity; bias: signed, positive
    where this view is nearer; coc_px: median difference as a CoC radius at A = 1, pixels.
    """

    neighbours: tuple[str, ...]
    compared: float
    consistent: float
    difference: float
    bias: float
    coc_px: float


def consistencies(
    names: Sequence[str],
    cameras: Sequence[Camera],
    depth_of: Callable[[int], np.ndarray],
    points: PointCloud | None,
    disparity_range: DisparityRange,
    progress: Callable[[int], None] | None = None,
    *,
    at_once: int = 1,
) -> list[Consistency | None]:
    """Consistency of every view; None where no neighbour shares enough of it.

    depth_of: gives a view's z-depth (H, W) by index, scene units, 0 where unknown. points.views index into the views.
    progress: called with the number of views done. at_once: views at a time.
    """
    cached = lru_cache(maxsize=4 * NEIGHBOURS)(depth_of)
    locks = [threading.Lock() for _ in cameras]
    others_of = neighbours(cameras, points)

    def read(index: int) -> np.ndarray:
        with locks[index]:  # the second of two threads that need a map gets the first one's
            return cached(index)

    def compare(index: int) -> Consistency | None:
        pairs = [
            (other, _compare(cameras[index], read(index), cameras[other], read(other))) for other in others_of[index]
        ]
        said = [(other, pair) for other, pair in pairs if pair is not None]
        return _summary(names, said, cameras[index].width, disparity_range)

    found: list[Consistency | None] = []
    for one in over_views(compare, range(len(cameras)), at_once):
        found.append(one)
        if progress is not None:
            progress(len(found))
    return found


def views_off(found: Sequence[Consistency | None]) -> list[int]:
    """Indices of views whose depth disagrees with their neighbours'.

    The median relative difference of disparity exceeds 20 %, or 2 % and 4 times the other views' median; or the share
    of disagreeing pixels exceeds 10 % and 4 times theirs (swapped maps of similar views differ at outlines only).
    """
    known = [(index, one.difference, 1 - one.consistent) for index, one in enumerate(found) if one is not None]
    off = []
    for index, difference, share in known:
        others = [(theirs, disagree) for other, theirs, disagree in known if other != index]
        if difference > WORST:
            off.append(index)
        elif len(others) > 1:
            usual, usual_share = np.median(others, axis=0)
            if difference > max(PEERS * usual, UNREMARKABLE) or share > max(PEERS * usual_share, UNREMARKABLE_SHARE):
                off.append(index)
    return off


def neighbours(cameras: Sequence[Camera], points: PointCloud | None) -> list[list[int]]:
    """Up to four neighbours of every view: those that share most points, else the nearest that look the same way."""
    count = len(cameras)
    centres = np.stack([camera.centre for camera in cameras])
    ways = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    away = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    # Rounded, so that of two equally distant cameras the first is taken, not the one that rounding noise favours.
    away = np.round(away / (away.max() or 1.0) + (1 - ways @ ways.T), _NOISE)
    shared = np.zeros((count, count))
    if points is not None and points.views is not None and len(points):
        import scipy.sparse as sparse

        tracks = points.views
        seen = np.concatenate(tracks) if tracks else np.empty(0, dtype=np.int64)
        which = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
        sight = sparse.csr_array((np.ones(len(seen)), (which, seen)), shape=(len(tracks), count))
        shared = (sight.T @ sight).toarray()
    chosen = []
    for index in range(count):
        others = [other for other in range(count) if other != index]
        others.sort(key=lambda other: (-shared[index, other], away[index, other]))
        chosen.append(others[:NEIGHBOURS])
    return chosen


@dataclass(frozen=True, eq=False)
class _Pair:
    """relative: (P,) signed relative differences of the comparable pixels. absolute: median, 1 / scene unit."""

    compared: float
    relative: np.ndarray
    absolute: float

    @property
    def difference(self) -> float:
        return float(np.median(np.abs(self.relative)))


def _compare(camera: Camera, depth: np.ndarray, other: Camera, other_depth: np.ndarray) -> _Pair | None:
    height, width = depth.shape
    step = math.ceil(math.sqrt(height * width / _PIXELS))
    rows, columns = (grid.ravel() for grid in np.mgrid[step // 2 : height : step, step // 2 : width : step])
    z = depth[rows, columns].astype(np.float64)
    known = z > 0
    if not known.any():
        return None
    world = _lift(camera, rows[known], columns[known], z[known])
    _, row, column, expected = _look_up(other, other_depth, world)
    there = other_depth[row, column].astype(np.float64)
    mine, theirs = 1 / expected, 1 / there
    # The neighbour shows something nearer there: find where this view shows it.
    nearer = theirs > mine * (1 + AGREEMENT)
    hidden = np.zeros(len(mine), dtype=bool)
    occluders = _lift(other, row[nearer], column[nearer], there[nearer])
    back, back_row, back_column, back_z = _look_up(camera, depth, occluders)
    agree = np.abs(back_z / depth[back_row, back_column] - 1) <= AGREEMENT
    hidden[np.flatnonzero(nearer)[np.flatnonzero(back)[agree]]] = True
    difference = (mine - theirs)[~hidden]
    compared = len(difference) / int(known.sum())
    if compared < _LEAST:
        return None
    relative = difference / (0.5 * (mine + theirs)[~hidden])
    return _Pair(compared, relative, float(np.median(np.abs(difference))))


def _lift(camera: Camera, rows: np.ndarray, columns: np.ndarray, z: np.ndarray) -> np.ndarray:
    """World points (P, 3) at depth z behind the centres of pixels."""
    x, y = camera.rays(columns + 0.5, rows + 0.5)
    local = np.stack([x * z, y * z, z], axis=1)
    return (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]


def _look_up(
    camera: Camera, depth: np.ndarray, world: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Which world points (P, 3) fall on a pixel of known depth, (P,) bool; and of those the row, column and z."""
    xy, z = camera.project(world)
    xy = xy + _BORDER
    inside = camera.inside(xy)
    row, column = xy[inside, 1].astype(int), xy[inside, 0].astype(int)
    known = depth[row, column] > 0
    seen = inside.copy()
    seen[inside] = known
    return seen, row[known], column[known], z[inside][known]


def _summary(
    names: Sequence[str], said: Sequence[tuple[int, _Pair]], width: int, disparity_range: DisparityRange
) -> Consistency | None:
    if not said:
        return None
    # Differences below the rounding noise count as equal, and then the first neighbour's is taken.
    ordered = sorted((pair for _, pair in said), key=lambda pair: round(pair.difference, _NOISE))
    typical = ordered[(len(ordered) - 1) // 2]
    return Consistency(
        neighbours=tuple(names[other] for other, _ in said),
        compared=typical.compared,
        consistent=float((np.abs(typical.relative) <= AGREEMENT).mean()),
        difference=typical.difference,
        bias=float(np.median(typical.relative)),
        coc_px=COC_FRACTION * width / disparity_range.extent * typical.absolute,
    )
