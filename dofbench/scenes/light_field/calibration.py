"""How points move between the views of a light field, measured by matched features.

A camera that moves in a plane without turning sees a point of disparity q at x + q M p when it is at p; M is one 2 x 2
matrix for all views: the directions of the grid's rows and columns in the images, and their lengths. This holds for
fixed principal points as well as for views that are registered on a plane, whose principal points move with p: that
adds the same q to all points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import to_8bit
from dofbench.scenes.light_field.grid import Grid, Place

_FEATURES, _CONTRAST = 4000, 0.02  # SIFT's: sharp views have plenty of faint ones
_DISTINCT = 0.75  # Lowe's ratio
_ACROSS = 5  # views in each direction whose features are matched with the centre view's
_LEAST_POINTS, _LEAST_SIGHTINGS = 50, 4
_STEPS = 30
# A median distance from the epipolar lines above this is no grid of one camera that doesn't turn.
MOST_EPIPOLAR_PX = 1.0
_PERCENTILES = (1.0, 99.0)


@dataclass(frozen=True, eq=False)
class Calibration:
    """The motion of points between views, in pixels of the grid's own size.

    matrix: M, (2, 2), from a position to (down, right), of determinant 1 or -1. Its sign is arbitrary: -M and -q move
    points alike. disparities: percentiles 1 and 99 of the features' q, pixels per unit. points: number of features;
    matches: of these, in all views. epipolar_px: median distance of a match from its epipolar line; residual_px: median
    distance from where the point's own q puts it.
    """

    matrix: np.ndarray
    disparities: tuple[float, float]
    points: int
    matches: int
    epipolar_px: float
    residual_px: float


def calibrate(grid: Grid) -> Calibration:
    """Fit M and every feature's disparity to features matched between the centre view and up to 24 others.

    Alternating least squares, Cauchy weights. Raises InputError for too few matches, and for matches that are off their
    epipolar lines.
    """
    matches = _matched(grid)
    if matches.points < _LEAST_POINTS:
        found = f"{matches.points} features that {_LEAST_SIGHTINGS} views share"
        raise InputError(grid.root, found, f"at least {_LEAST_POINTS}: sharp views of textured surfaces")
    # Rows may run down or across in the images, and either way: the fit starts at the best of four matrices.
    starts = [np.array(start, dtype=np.float64) for start in ([[1, 0], [0, 1]], [[1, 0], [0, -1]])]
    starts += [start[::-1] for start in starts]
    start = min((_fit(matches, start, steps=3) for start in starts), key=lambda fit: fit.spread).matrix
    fit = _fit(matches, start, _STEPS)
    direction = matches.positions @ fit.matrix.T
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    across = np.abs(matches.moved[:, 0] * direction[:, 1] - matches.moved[:, 1] * direction[:, 0])
    epipolar = float(np.median(across))
    if epipolar > MOST_EPIPOLAR_PX:
        raise InputError(
            grid.root,
            f"features {epipolar:.2f} px off their epipolar lines (median)",
            f"at most {MOST_EPIPOLAR_PX:g} px: views of one camera that moved in a plane, parallel to its sensor",
        )
    low, high = (float(end) for end in np.percentile(fit.disparity, _PERCENTILES))
    return Calibration(fit.matrix, (low, high), matches.points, len(matches.point), epipolar, fit.spread)


@dataclass(frozen=True, eq=False)
class _Matches:
    """Features of the centre view found again. point: (N,) index of the feature; moved: (N, 2) by how much, (down,
    right), pixels; positions: (N, 2) of the views."""

    points: int
    point: np.ndarray
    moved: np.ndarray
    positions: np.ndarray


def _matched(grid: Grid) -> _Matches:
    import cv2

    finder = cv2.SIFT.create(_FEATURES, contrastThreshold=_CONTRAST)

    def features(place: Place) -> tuple[np.ndarray, np.ndarray]:
        grey = cv2.cvtColor(to_8bit(grid.read(place)), cv2.COLOR_RGB2GRAY)
        points, descriptors = finder.detectAndCompute(grey, None)
        at = np.array([point.pt[::-1] for point in points], dtype=np.float64).reshape(-1, 2)
        return at, np.empty((0, 128), np.float32) if descriptors is None else descriptors

    centre, centre_descriptors = features((0, 0))
    matcher, point, moved, positions = cv2.BFMatcher(), [], [], []
    for place in _spread(grid):
        others, descriptors = features(place)
        if min(len(centre), len(others)) < 2:
            continue
        back = {pair.queryIdx: pair.trainIdx for pair in matcher.match(descriptors, centre_descriptors)}
        for best, second in matcher.knnMatch(centre_descriptors, descriptors, k=2):
            if best.distance < _DISTINCT * second.distance and back[best.trainIdx] == best.queryIdx:
                point.append(best.queryIdx)
                moved.append(others[best.trainIdx] - centre[best.queryIdx])
                positions.append(grid.positions[place])
    which = np.array(point, dtype=np.int64)
    sightings = np.bincount(which, minlength=len(centre))
    kept = sightings[which] >= _LEAST_SIGHTINGS
    seen, which = np.unique(which[kept], return_inverse=True)
    return _Matches(
        len(seen),
        which,
        np.array(moved, dtype=np.float64).reshape(-1, 2)[kept],
        np.array(positions, dtype=np.float64).reshape(-1, 2)[kept],
    )


def _spread(grid: Grid) -> list[Place]:
    """Places evenly over the grid, without the centre."""
    along = sorted({int(step) for step in np.linspace(-grid.steps, grid.steps, _ACROSS).round()})
    return [place for place in product(along, along) if place != (0, 0)]


@dataclass(frozen=True, eq=False)
class _Fit:
    """matrix: M. disparity: (P,), of each point. spread: median residual, pixels."""

    matrix: np.ndarray
    disparity: np.ndarray
    spread: float


def _fit(matches: _Matches, matrix: np.ndarray, steps: int) -> _Fit:
    """Alternate between the points' disparities, with the place where each really is in the centre view, and M."""
    count, point, moved = matches.points, matches.point, matches.moved
    weight = np.ones(len(point))
    scale = float(np.median(np.linalg.norm(moved, axis=1)))

    def mean(values: np.ndarray) -> np.ndarray:
        """Weighted mean of each point's matches and its place in the centre view, where `values` are zero."""
        total = 1.0 + np.bincount(point, weight, count)
        return np.stack([np.bincount(point, weight * column, count) / total for column in values.T], axis=1)

    for _ in range(steps):
        motion = matches.positions @ matrix.T
        mean_motion, mean_moved = mean(motion), mean(moved)
        # Moments around the means; the centre view's own sighting has weight 1.
        cross = np.bincount(point, weight * (motion * moved).sum(axis=1), count)
        square = np.bincount(point, weight * (motion**2).sum(axis=1), count)
        total = 1.0 + np.bincount(point, weight, count)
        cross -= total * (mean_motion * mean_moved).sum(axis=1)
        square -= total * (mean_motion**2).sum(axis=1)
        disparity = cross / np.maximum(square, 1e-12)
        place = mean_moved - disparity[:, None] * mean_motion
        root = np.sqrt(weight)[:, None]
        steps_of = disparity[point][:, None] * matches.positions
        matrix = np.linalg.lstsq(root * steps_of, root * (moved - place[point]), rcond=None)[0].T
        matrix = matrix / np.sqrt(max(abs(np.linalg.det(matrix)), 1e-24))
        residual = moved - place[point] - disparity[point][:, None] * (matches.positions @ matrix.T)
        distance = np.linalg.norm(residual, axis=1)
        scale = max(float(np.median(distance)), 1e-6)
        weight = 1 / (1 + (distance / (3 * scale)) ** 2)
    return _Fit(matrix, disparity, scale)
