"""The pattern of aperture samples, and the blur of the cell that each of them stands for.

Together, points and cells blur as a disc of radius R: their transfer function is nearest to the disc's,
2 J1(k R) / (k R), in the mean square over photographs, whose amplitudes fall as 1 / k (Field, 1987), up to the finest
frequency of pixels. So an aperture learned through the pattern isn't biased. One with only the disc's variance is: a
single Gaussian of variance R^2 / 4 fits a wide disc best at a radius 12 % too large, because a disc's rim is steep.
`python -m benchmarks.lens.pattern` computes the constants again.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

MOST_RINGS = 3  # 37 points: affordable in rendering, where each image is rendered once; training uses fewer
# px: the widest CoC radius for 0 rings and 1; more rings have cells of `_CELL`. One point has no occlusion.
_WIDEST = (1.0, 3.5)
_CELL = 1.5  # px: largest blur radius of a cell
_WIDE_SHARE = 0.01  # of an image's CoC radii may be wider

_RING_OF_FIVE = 0.609  # radius of five points without a centre, on the unit lens
_CELL_OF_FIVE = 0.0836  # variance of each one's cell, in units of R^2
# The variance of a single cell in units of R^2, the whole disc: its own 1/4 while the disc is small against a pixel,
# more where its rim is resolved.
_SMALL_CELL, _WIDE_CELL, _RESOLVED = 0.25, 0.314, 1.0  # the last: px^3


def points_of(rings: int) -> int:
    """Number of points: 1, 5, and from two rings on the centre and rings of 6, 12, 18 ..."""
    return (1, 5)[rings] if rings < 2 else 1 + 3 * rings * (rings + 1)


def rings_for(circles: Tensor, most: int = MOST_RINGS) -> int:
    """The smallest number of rings, at most `most`, for an image with these CoC radii.

    circles: (M,) px, NaN outside the image. The search for a lens in scoring renders some eighty images per view, most
    of them with small CoCs, for which 37 points would be a waste.
    """
    if most == 0:
        return 0
    # Counted on the device, which then returns a few numbers.
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
    """(N,) px^2: variance along each axis of the blur of one cell. radius: (N,) CoC radii R, px; the whole disc's
    variance is R^2 / 4."""
    squared = radius.square()
    if rings == 0:
        cubed = squared * radius.abs()
        return squared * (_SMALL_CELL + (_WIDE_CELL - _SMALL_CELL) * cubed / (cubed + _RESOLVED))
    return squared * (_CELL_OF_FIVE if rings == 1 else 0.25 / points_of(rings))
