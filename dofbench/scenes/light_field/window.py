"""A round window of a light field's grid: the weights by which its views are averaged."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import product

import numpy as np

from dofbench.scenes.light_field.grid import Place

_ACROSS = 16  # samples across a grid cell, to find how much of it is in the window
_NEWTON_STEPS, _MET = 50, 1e-13
_LONGEST = 2.0  # change of a weight's logarithm in one of Newton's steps


def cells(radius: float) -> dict[Place, float]:
    """Share of each grid cell within a disc of `radius` steps around the middle cell's centre; only cells with any."""
    reach = reach_of(radius)
    samples = (np.arange(_ACROSS) + 0.5) / _ACROSS - 0.5
    found = {}
    for row, column in product(range(-reach, reach + 1), repeat=2):
        share = float(np.mean((row + samples[:, None]) ** 2 + (column + samples) ** 2 <= radius**2))
        if share > 0:
            found[row, column] = share
    return found


def reach_of(radius: float) -> int:
    """Steps from the middle of a window of `radius` steps to its outermost views."""
    return int(radius + 0.5)


def weights(
    radius: float, step: float, positions: Mapping[Place, np.ndarray], excluded: Collection[Place] = ()
) -> dict[Place, float] | None:
    """Weights of the views around a view, of sum 1, for the photograph by a disc of `radius` around it.

    radius, step: of the grid, in the positions' unit. positions: (2,) of every view around, relative to the middle
    one's, by place relative to it. excluded: places of the window that aren't used.

    The weights are those nearest to the shares of the views' cells in the disc (least relative entropy) by which the
    aperture's centre and its second moments are exactly the disc's: mean u = 0, mean u u^T = radius^2 / 4. To this
    order the blur is that of a disc, wherever the views really are and without the excluded ones. None where no
    positive weights do that: too few views.
    """
    shares = {place: share for place, share in cells(radius / step).items() if place not in excluded}
    u = np.array([positions[place] for place in shares]) / radius
    terms = np.stack([u[:, 0], u[:, 1], u[:, 0] ** 2, u[:, 0] * u[:, 1], u[:, 1] ** 2], axis=1)
    found = _nearest(np.array(list(shares.values())), terms, np.array([0.0, 0.0, 0.25, 0.0, 0.25]))
    return None if found is None else dict(zip(shares, found.tolist(), strict=True))


def _nearest(shares: np.ndarray, terms: np.ndarray, wanted: np.ndarray) -> np.ndarray | None:
    """Weights (N,) of sum 1, in proportion to shares * exp(terms @ c), with the wanted means of `terms` (N, K); None if
    there are none. Newton's method for c, whose objective is convex."""
    factors = np.zeros(len(wanted))
    for _ in range(_NEWTON_STEPS):
        exponent = terms @ factors
        weights = shares * np.exp(exponent - exponent.max())
        weights /= weights.sum()
        means = weights @ terms
        if np.abs(means - wanted).max() < _MET:
            return weights
        covariance = (terms.T * weights) @ terms - np.outer(means, means)
        step = np.linalg.lstsq(covariance, wanted - means, rcond=None)[0]
        factors = factors + step * min(1.0, _LONGEST / max(float(np.abs(terms @ step).max()), 1e-12))
    return None
