"""Evenly distributed aperture samples."""

from __future__ import annotations

import math

import numpy as np

from dofbench.core.lens import ApertureShape

# Steps of Roberts' R2 sequence: powers of the real root of x^3 = x + 1 (M. Roberts, The Unreasonable Effectiveness of
# Quasirandom Sequences, 2018). Any consecutive part of it is evenly distributed.
_ROOT = 1.32471795724474602596
_STEPS = np.array([1 / _ROOT, 1 / _ROOT**2])


def lens_points(count: int, shape: ApertureShape = ApertureShape(), first: int = 0) -> np.ndarray:
    """(count, 2) float64 points (x, y) of an aperture whose corners, or rim, are at radius 1.

    first: number of skipped points: lens_points(a + b) is lens_points(a) followed by lens_points(b, first=a).
    """
    chosen: list[np.ndarray] = []
    found, index = 0, 0
    while found < first + count:
        points = 2 * np.mod(0.5 + (np.arange(index, index + 4096) + 1)[:, None] * _STEPS, 1) - 1
        index += len(points)
        radius = np.hypot(points[:, 0], points[:, 1])
        rim = shape.radius_factor(np.arctan2(points[:, 1], points[:, 0]))
        chosen.append(points[(radius <= rim) & (radius >= shape.obstruction * rim)])
        found += len(chosen[-1])
    return np.concatenate(chosen)[first : first + count] if chosen else np.zeros((0, 2))


def polygon_to_disc(shape: ApertureShape) -> float:
    """Radius of the disc with the area of an aperture whose corners are at radius 1."""
    angle = np.linspace(0, 2 * math.pi, 3600, endpoint=False)
    return math.sqrt(float(np.mean(shape.radius_factor(angle) ** 2)) * (1 - shape.obstruction**2))
