"""Do the views agree on depth? Reprojection consistency of every view with a few neighbours.

A pixel is lifted by its depth and projected into the neighbour, where the two disparities should be equal. Where the
neighbour sees something nearer, that may be an occluder: it is if, lifted and projected back, it agrees with the
first view too; then the pair says nothing about the pixel. Otherwise the views contradict each other. So a view
whose depth is off by a factor cannot pass for one that is hidden everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.core.lens import COC_FRACTION, DisparityRange

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
    """How far a view's depth agrees with its neighbours'. None: no neighbour shares enough of the view.

    compared: share of the view's known pixels that land on known depth of a neighbour, and aren't hidden there.
    consistent: share of those whose disparities differ by 5 % at most. difference: median relative
    difference of disparity; bias: its median with the sign, positive where this view says nearer;
    coc_px: median difference as a CoC radius at A = 1, pixels. They are those of the neighbour in the
    middle by difference, or before the middle, so that a view isn't blamed for a neighbour that is off.
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
) -> list[Consistency | None]:
    """One for every view. depth_of: index of a view to its z-depth (H, W), scene units, 0 where unknown.

    points.views index into the views. progress: called with the number of views done.
    """
    read = lru_cache(maxsize=4 * NEIGHBOURS)(depth_of)
    found: list[Consistency | None] = []
    for index, others in enumerate(neighbours(cameras, points)):
        pairs = [(other, _compare(cameras[index], read(index), cameras[other], read(other))) for other in others]
        said = [(other, pair) for other, pair in pairs if pair is not None]
        found.append(_summary(names, said, cameras[index].width, disparity_range))
        if progress is not None:
            progress(index + 1)
    return found


def views_off(found: Sequence[Consistency | None]) -> list[int]:
    """Indices of the views whose depth disagrees with their neighbours'.

    A view is off when its median relative difference of disparity exceeds 20 %; or when that exceeds 2 %
    and 4 times the median of all the other views'; or when the share of its pixels that disagree does
    so with 10 % (two alike views' maps swapped differ at their outlines alone).
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
        order = sorted(
            (other for other in range(count) if other != index),
            key=lambda other: (-shared[index, other], away[index, other]),
        )
        chosen.append(order[:NEIGHBOURS])
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
    back, back_row, back_column, back_z = _look_up(
        camera, depth, _lift(other, row[nearer], column[nearer], there[nearer])
    )
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
