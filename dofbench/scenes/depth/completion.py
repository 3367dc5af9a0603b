"""Edge-aware completion of disparity at scattered pixels, guided by the colour image.

Minimises over the disparity q, with p, p' neighbouring pixels and i the sightings:

    sum_i w_i rho_i (q(x_i) - q_i)^2 + SMOOTH sum_pp' exp(-EDGE |c_p - c_p'|) r_pp' (q_p - q_p')^2

a weighted Laplacian with data terms (Levin, Lischinski, Weiss: Colorization using Optimization, 2004, with another
affinity). Disparity is what is interpolated, not depth: a plane's is affine in the pixel, and blur is linear in it.
Reweighting makes the data term robust (rho, Geman-McClure) and lets the surface break where it wants to (r, about an
L1 norm of the gradient). Solved directly when coarse, then by conjugate gradients from scale to scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

from dofbench.scenes.depth.sightings import Sightings

_EDGE = 50.0  # per unit of colour distance, CIELAB / 100
_LEAK = 1e-3  # affinity across the strongest edge: every pixel stays connected
_SMOOTH = 0.1  # weight of smoothness against an exact sighting's 1
_BREAK = 0.01  # step between neighbours, share of the range, at which the L1 part begins
_OUTLIER = 0.03  # residual of a sighting, share of the range, from which its weight falls
_COARSEST = 240  # pixels, width that is solved directly at most
_FINEST = 1280  # pixels, width that is solved at most; above, the result is enlarged
_COARSE_ROUNDS, _FINE_STEPS = 3, 60


@dataclass(frozen=True, eq=False)
class Completion:
    """disparity: (H, W) float64, 1 / scene unit. residual: (M,), sightings - surface. trusted: (M,) rho_i, 0 to 1."""

    disparity: np.ndarray
    residual: np.ndarray
    trusted: np.ndarray


def complete(image: np.ndarray, sightings: Sightings, extent: float) -> Completion:
    """Complete the disparity of at least one sighting to all pixels.

    image: (H, W, 3) float32, encoded. extent: range of the scene's disparities, 1 / scene unit. Gives the same bits for
    any number of threads: no threaded library sums.
    """
    height, width = image.shape[:2]
    widths = [min(width, _FINEST)]
    while widths[-1] > _COARSEST:
        widths.append((widths[-1] + 1) // 2)
    surface: np.ndarray | None = None
    system = None
    for columns in reversed(widths):
        rows = max(2, round(height * columns / width))
        system = _System(image, sightings, max(2, columns), rows, extent)
        if surface is None:
            surface = np.full((system.rows, system.columns), float(np.median(sightings.disparity)))
            for repeat in range(_COARSE_ROUNDS):
                surface = system.solved(surface, robust=repeat > 0, steps=None)
        else:
            enlarged = cv2.resize(surface, (system.columns, system.rows), interpolation=cv2.INTER_LINEAR)
            surface = system.solved(enlarged, robust=True, steps=_FINE_STEPS)
    assert surface is not None and system is not None
    residual = sightings.disparity - system.at_sightings @ surface.ravel()
    trusted = _geman_mcclure(residual / extent, _OUTLIER)
    if surface.shape != (height, width):
        surface = cv2.resize(surface, (width, height), interpolation=cv2.INTER_LINEAR)
    return Completion(surface, residual, trusted)


class _System:
    """The linear system at one scale."""

    def __init__(self, image: np.ndarray, sightings: Sightings, columns: int, rows: int, extent: float):
        self.columns, self.rows, self._extent = columns, rows, extent
        small = image
        if image.shape[:2] != (rows, columns):
            small = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
        lab = cv2.cvtColor(np.ascontiguousarray(small, dtype=np.float32), cv2.COLOR_RGB2LAB) / 100
        index = np.arange(rows * columns).reshape(rows, columns)
        first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
        second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
        colours = lab.reshape(-1, 3)
        self._affinity = np.exp(-_EDGE * np.linalg.norm(colours[first] - colours[second], axis=1)) + _LEAK
        links, one = np.arange(len(first)), np.ones(len(first))
        places = np.concatenate([links, links]), np.concatenate([first, second])
        shape = (len(first), index.size)
        self._difference = sparse.csr_matrix((np.concatenate([one, -one]), places), shape=shape)
        here = sightings.scaled(columns / image.shape[1], rows / image.shape[0])
        self.at_sightings = _bilinear(here.xy, columns, rows)
        self._data, self._weight = sightings.disparity, sightings.weight

    def solved(self, surface: np.ndarray, *, robust: bool, steps: int | None) -> np.ndarray:
        """The minimum (rows, columns) with the weights that `surface` gives; steps: of conjugate gradients from there.

        robust False takes all weights as they are; steps None solves directly.
        """
        flat = surface.ravel()
        trusted, broken = np.ones(len(self._data)), np.ones(len(self._affinity))
        if robust:
            trusted = _geman_mcclure((self._data - self.at_sightings @ flat) / self._extent, _OUTLIER)
            step = (self._difference @ flat) / (self._extent * _BREAK)
            broken = 1 / np.sqrt(1 + step**2)
        data = self.at_sightings.T @ sparse.diags_array(self._weight * trusted)
        smooth = self._difference.T @ sparse.diags_array(_SMOOTH * self._affinity * broken)
        matrix, right = data @ self.at_sightings + smooth @ self._difference, data @ self._data
        if steps is None:
            # A small weight on the previous surface keeps the system solvable when all sightings are rejected.
            grain = 1e-9 * _SMOOTH
            matrix = (matrix + grain * sparse.eye_array(flat.size)).tocsc()
            factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            return factors.solve(right + grain * flat).reshape(surface.shape)
        return _conjugate_gradients(matrix.tocsr(), right, flat, steps).reshape(surface.shape)


def _conjugate_gradients(matrix: sparse.csr_array, right: np.ndarray, start: np.ndarray, steps: int) -> np.ndarray:
    """A fixed number of steps, preconditioned by the diagonal; sums by numpy, not by a threaded BLAS."""
    inverse = 1 / matrix.diagonal()
    x, residual = start.copy(), right - matrix @ start
    direction = inverse * residual
    before = _dot(residual, direction)
    for _ in range(steps):
        if before <= 0:
            break
        moved = matrix @ direction
        step = before / _dot(direction, moved)
        x += step * direction
        residual -= step * moved
        scaled = inverse * residual
        after = _dot(residual, scaled)
        direction = scaled + (after / before) * direction
        before = after
    return x


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sum(a * b))


def _geman_mcclure(residual: np.ndarray, scale: float) -> np.ndarray:
    return 1 / (1 + (residual / scale) ** 2) ** 2


def _bilinear(xy: np.ndarray, columns: int, rows: int) -> sparse.csr_array:
    """(M, rows * columns): bilinear samples at image coordinates (M, 2), pixel centres at half-integers."""
    x, y = np.clip(xy[:, 0] - 0.5, 0, columns - 1), np.clip(xy[:, 1] - 0.5, 0, rows - 1)
    left, top = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
    right_share, bottom_share = x - left, y - top
    corner = top * columns + left
    number = np.arange(len(xy))
    weights = [
        (1 - right_share) * (1 - bottom_share),
        right_share * (1 - bottom_share),
        (1 - right_share) * bottom_share,
        right_share * bottom_share,
    ]
    places = [corner, corner + 1, corner + columns, corner + columns + 1]
    return sparse.csr_array(
        (np.concatenate(weights), (np.tile(number, 4), np.concatenate(places))), shape=(len(xy), rows * columns)
    )
