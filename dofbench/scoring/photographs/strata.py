"""Where the photographs of one aperture are more blurred than those of another: told by the photographs, by no method.

At every sparse point, the energy of gradients around it in the training photographs is compared with that in the test
photographs. A point is where it is whatever a method thinks of its depth, so no method is favoured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.scenes.visibility import visible

SMOOTH, WINDOW = 1.0, 3.0  # px: against noise, before gradients are taken; around a point
VIEWS = 3  # photographs of either kind that must see a point, for a median to mean anything
FEWEST = 64  # such points, for a map of them to mean anything
NEAREST = 8  # points that a pixel takes its value from
_LEAST = 1e-6  # energy of gradients that counts as none

Shot = tuple[Camera, np.ndarray]  # of a photograph: its camera, and the image (H, W, 3), encoded


def sharpness_ratio(points: PointCloud, training: Sequence[Shot], test: Sequence[Shot]) -> np.ndarray:
    """(P,) energy of gradients around each point in the training photographs over that in the test photographs, medians
    of each; NaN for a point that fewer than three of either see. Below 1: the training photographs are more blurred.

    Each energy is relative to the square of the local brightness, so that exposure doesn't count.
    """
    untracked = replace(points, views=None)  # a track has the views in which the point was found, so where it is sharp
    medians = []
    for shots in (training, test):
        found = np.full((len(shots), len(points)), np.nan)
        for row, (camera, image) in zip(found, shots, strict=True):
            seen = visible(untracked, camera, 0)
            if len(seen.index):
                at = np.floor(seen.xy).astype(int)
                row[seen.index] = gradient_energy(image)[at[:, 1], at[:, 0]]
        enough = np.isfinite(found).sum(axis=0) >= VIEWS
        median = np.full(len(points), np.nan)
        median[enough] = np.nanmedian(found[:, enough], axis=0)
        medians.append(median)
    return (medians[0] + _LEAST) / (medians[1] + _LEAST)


def gradient_energy(image: np.ndarray) -> np.ndarray:
    """(H, W): squared gradients of grey around every pixel, over the squared grey there."""
    from scipy.ndimage import gaussian_filter, sobel

    grey = gaussian_filter(image.astype(np.float64).mean(axis=2), SMOOTH)
    squares = sobel(grey, axis=0) ** 2 + sobel(grey, axis=1) ** 2
    return gaussian_filter(squares, WINDOW) / (gaussian_filter(grey, WINDOW) ** 2 + 1e-3)


def thirds(points: PointCloud, ratio: np.ndarray, camera: Camera, inside: np.ndarray) -> np.ndarray | None:
    """(H, W) int8 of a view: 0 and 2 for the thirds of its scored pixels (`inside`) in which the training photographs
    are most and least blurred against the test photographs, 1 between, -1 not scored. A pixel has the mean of the
    logarithms at the eight nearest points, the nearer the more. None with too few points.
    """
    from scipy.spatial import cKDTree

    seen = visible(replace(points, views=None), camera, 0)
    known = np.isfinite(ratio[seen.index])
    if np.count_nonzero(known) < FEWEST:
        return None
    values = np.log(ratio[seen.index][known])
    rows, columns = np.nonzero(inside)
    distance, index = cKDTree(seen.xy[known]).query(np.stack([columns + 0.5, rows + 0.5], axis=1), k=NEAREST)
    weight = 1.0 / (distance + 1.0)
    value = (values[index] * weight).sum(axis=1) / weight.sum(axis=1)
    order = np.empty(len(value), dtype=np.int64)
    order[np.argsort(value, kind="stable")] = np.arange(len(value))
    result = np.full(inside.shape, -1, dtype=np.int8)
    result[rows, columns] = (order * 3 // len(value)).astype(np.int8)
    return result
