"""Which points stand for a whole lens, and the blur of the cell that each of them stands for.

Points and cells are chosen so that together they blur as a disc of radius R does: their transfer function is nearest to
the disc's, 2 J1(k R) / (k R), in the mean square over photographs, whose amplitudes fall as 1 / k (Field, 1987), up to
the finest frequency that pixels hold. The best scale of such a pattern is that of the disc, so an aperture learned
through it isn't biased. A pattern that only has the disc's variance is biased: a single Gaussian of variance R^2 / 4
fits a wide disc best at a radius 12 % too large, because a disc's rim is steep. `python -m benchmarks.lens.pattern`
computes the constants again.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

MOST_RINGS = 3  # 37 lens points: affordable in rendering, where each picture is rendered once; training uses fewer
# px: the widest circle of confusion for which a pattern is used, by its number of rings; wider ones need more rings.
# One point has no occlusion; 1 + 3 k (k + 1) points have cells of a pixel and a half.
_WIDEST = (1.0, 3.5)
_CELL = 1.5  # px: largest blur radius of a cell
_WIDE_SHARE = 0.01  # of a picture's circles of confusion may be wider than its number of points is meant for

_RING_OF_FIVE = 0.609  # radius of five points without a centre, on the unit lens
_CELL_OF_FIVE = 0.0836  # variance of each one's cell, in units of R^2
# The variance of a single cell in units of R^2, the whole disc: its own 1/4 while the disc is small against a pixel,
# more where its rim is resolved.
_SMALL_CELL, _WIDE_CELL, _RESOLVED = 0.25, 0.314, 1.0  # the last: px^3


def points_of(rings: int) -> int:
    """How many points so many rings have: 1, 5, and from two rings on the centre and rings of 6, 12, 18 ..."""
    return (1, 5)[rings] if rings < 2 else 1 + 3 * rings * (rings + 1)


def rings_for(circles: Tensor, most: int = MOST_RINGS) -> int:
    """The smallest number of rings, at most `most`, that suits a picture with these circles of confusion.

    circles: (M,) radii, pixels, NaN for what the picture doesn't show. The search for a lens in scoring renders some
    eighty pictures per photograph, most of them with small circles, for which 37 points would be a waste.
    """
    if most == 0:
        return 0
    # Counted where the circles lie, so that a few numbers are all that a device has to hand over.
    shown = ~circles.isnan()
    wider = torch.stack([(circles > _widest(rings)).sum() for rings in range(most)] + [shown.sum()]).tolist()
    few = _WIDE_SHARE * wider.pop()
    return next((rings for rings, count in enumerate(wider) if count <= few), most)


def _widest(rings: int) -> float:
    return _WIDEST[rings] if rings < len(_WIDEST) else _CELL * math.sqrt(points_of(rings))


def lens_points(rings: int, rotation: float = 0.0) -> np.ndarray:
    """(N, 2) points on the unit disc, each for an equal area; rotation: radians.

    From two rings on: the centre and rings of 6, 12, 18 ..., the radius of each such that points and cells together
    have the disc's variance, 1/4 along each axis, and each ring with its cells the variance of its annulus.
    """
    if rings == 1:
        angles = rotation + 2 * math.pi * np.arange(5) / 5
        return _RING_OF_FIVE * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    count = points_of(rings)
    points = [(0.0, 0.0)]
    for ring in range(1, rings + 1):
        radius = math.sqrt((0.5 + 3 * ring**2) / count)
        angles = rotation + 2 * math.pi * (np.arange(6 * ring) + 0.5 * (ring % 2)) / (6 * ring)
        points += [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]
    return np.array(points)


def cell_variance(radius: Tensor, rings: int) -> Tensor:
    """(N,) px^2: variance along each axis of the blur of one cell. radius: (N,) circles of confusion, pixels; the
    whole disc's variance is R^2 / 4."""
    squared = radius.square()
    if rings == 0:
        cubed = squared * radius.abs()
        return squared * (_SMALL_CELL + (_WIDE_CELL - _SMALL_CELL) * cubed / (cubed + _RESOLVED))
    return squared * (_CELL_OF_FIVE if rings == 1 else 0.25 / points_of(rings))
