"""Align a network's map to disparity in scene units: a robust scale and shift from the sparse points.

disparity = scale * output + shift, or for a network of depth, depth = scale * output + shift with errors divided by the
squared depth (their error in disparity to first order). Initialised by least median of squares (Rousseeuw, 1984), so
that half of the points may be wrong, then least squares reweighted to convergence (Geman-McClure).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

ENOUGH = 12  # points that a view needs for a scale and shift of its own
TRIALS = 256  # pairs of points that are tried for the start
_ROUNDS = 30
_MAD = 1.4826  # standard deviation of a normal distribution by its median absolute deviation
_OUTLIER = 2.5  # standard deviations up to which a residual counts as an inlier

Output = Literal["disparity", "depth"]
Freedom = Literal["scale-shift", "scale", "none"]


@dataclass(frozen=True)
class Alignment:
    """scale, shift: of the network's output. inliers: share of the points. residual: median, in disparity. shared: from
    all views together, as this one had too few points."""

    scale: float
    shift: float
    inliers: float
    residual: float
    shared: bool = False

    def disparity(self, output: np.ndarray, meaning: Output) -> np.ndarray:
        """Disparity of a map, 1 / scene unit; infinite for depth that is not positive."""
        aligned = self.scale * output.astype(np.float64) + self.shift
        if meaning == "disparity":
            return aligned
        return np.divide(1.0, aligned, out=np.full(aligned.shape, np.inf), where=aligned > 0)


UNALIGNED = Alignment(1.0, 0.0, 1.0, 0.0)


def middle(alignments: Sequence[Alignment]) -> Alignment:
    """The median scale and shift of several alignments."""
    names = ("scale", "shift", "inliers", "residual")
    scale, shift, inliers, residual = (float(np.median([getattr(one, name) for one in alignments])) for name in names)
    return Alignment(scale, shift, inliers, residual, shared=True)


def fit(
    output: np.ndarray, disparity: np.ndarray, weight: np.ndarray, meaning: Output, freedom: Freedom
) -> Alignment | None:
    """Align the network's output (M,) with the points' disparity (M,); weight: (M,), 0 ... 1.

    None with fewer than `ENOUGH` points, or where the best scale is not positive.
    """
    if len(output) < ENOUGH:
        return None
    columns = _columns(output, disparity, meaning, freedom)
    start = _least_median(columns, disparity)
    if start is None or start[0] <= 0:
        return None
    parameters = _reweighted(columns, disparity, weight, start)
    if parameters is None or parameters[0] <= 0:
        return None
    residual = np.abs(disparity - columns @ parameters)
    middle = float(np.median(residual))
    inliers = float(np.mean(residual <= _OUTLIER * _MAD * max(middle, 1e-12)))
    shift = float(parameters[1]) if len(parameters) > 1 else 0.0
    return Alignment(float(parameters[0]), shift, inliers, middle)


def _columns(output: np.ndarray, disparity: np.ndarray, meaning: Output, freedom: Freedom) -> np.ndarray:
    """(M, 1 or 2): what scale and shift multiply so that the product is the points' disparity, to first order."""
    if meaning == "disparity":
        columns = [output, np.ones_like(output)]
    else:
        # (z - scale * d - shift) / z^2 = 1/z - (scale * d + shift) / z^2
        columns = [output * disparity**2, disparity**2]
    return np.stack(columns[: 2 if freedom == "scale-shift" else 1], axis=1)


def _least_median(columns: np.ndarray, target: np.ndarray) -> np.ndarray | None:
    """Parameters with the smallest median residual among those that single points, or pairs, determine."""
    generator = np.random.default_rng(0)
    count = columns.shape[1]
    chosen = generator.integers(0, len(target), (TRIALS, count))
    systems, sides = columns[chosen], target[chosen]
    whole = np.abs(np.linalg.det(systems)) > 1e-12 * np.abs(systems).max() ** count
    if not whole.any():
        return None
    tried = np.linalg.solve(systems[whole], sides[whole][..., None])[..., 0]
    residual = np.median(np.abs(target - tried @ columns.T), axis=1)
    return tried[int(np.argmin(residual))]


def _reweighted(columns: np.ndarray, target: np.ndarray, weight: np.ndarray, start: np.ndarray) -> np.ndarray | None:
    parameters = start
    smallest = 1e-6 * float(np.abs(target).max())
    for _ in range(_ROUNDS):
        residual = target - columns @ parameters
        scale = max(_OUTLIER * _MAD * float(np.median(np.abs(residual))), smallest)
        root = np.sqrt(weight) / (1 + (residual / scale) ** 2)
        found, _, rank, _ = np.linalg.lstsq(columns * root[:, None], target * root, rcond=None)
        if rank < columns.shape[1]:
            return None
        if np.allclose(found, parameters, rtol=1e-9, atol=0.0):
            return found
        parameters = found
    return parameters
