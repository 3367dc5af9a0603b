"""Where images of one aperture are more blurred than those of another, by the images alone.

At every sparse point, the gradient energy in the training views is compared with that in the test views. No method's
depth is used, so no method is favoured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import PointCloud
from dofbench.scenes.visibility import visible

SMOOTH, WINDOW = 1.0, 3.0  # px, sigmas: smoothing before gradients; window around a point
VIEWS = 3  # fewest training and test views of a point
FEWEST = 64  # fewest such points for a map
NEAREST = 8  # points from which a pixel's value is interpolated
_LEAST = 1e-6  # smallest gradient energy

Shot = tuple[Camera, np.ndarray, np.ndarray | None]  # camera, image (H, W, 3), encoded, mask (H, W) or None


def sharpness_ratio(points: PointCloud, training: Sequence[Shot], test: Sequence[Shot]) -> np.ndarray:
    """(P,) median gradient energy around each point in the training views over that in the test views.

    Below 1: the training views are more blurred. NaN for a point in fewer than three training or test views. Energies
    are relative to the squared local brightness, so exposure has no influence.
    """
    # Tracks are ignored: they list the views in which the point is sharp
    untracked = replace(points, views=None)
    medians = []
    for shots in (training, test):
        found = np.full((len(shots), len(points)), np.nan)
        for row, (camera, image, mask) in zip(found, shots, strict=True):
            seen = visible(untracked, camera, 0).within(mask)
            if len(seen.index):
                at = np.floor(seen.xy).astype(int)
                row[seen.index] = gradient_energy(image)[at[:, 1], at[:, 0]]
        enough = np.isfinite(found).sum(axis=0) >= VIEWS
        median = np.full(len(points), np.nan)
        median[enough] = np.nanmedian(found[:, enough], axis=0)
        medians.append(median)
    return (medians[0] + _LEAST) / (medians[1] + _LEAST)


def gradient_energy(image: np.ndarray) -> np.ndarray:
    """(H, W): energy of grey-level gradients around every pixel, relative to the squared grey level."""
    from scipy.ndimage import gaussian_filter, sobel

    grey = gaussian_filter(image.astype(np.float64).mean(axis=2), SMOOTH)
    squares = sobel(grey, axis=0) ** 2 + sobel(grey, axis=1) ** 2
    return gaussian_filter(squares, WINDOW) / (gaussian_filter(grey, WINDOW) ** 2 + 1e-3)


def thirds(points: PointCloud, ratio: np.ndarray, camera: Camera, inside: np.ndarray) -> np.ndarray | None:
    """(H, W) int8 of a view: 0 and 2 for the thirds of its scored pixels (`inside`) in which the training views are
    most and least blurred relative to the test views, 1 between, -1 not scored; None with too few points.

    A pixel's value is the mean log ratio at the eight nearest points, weighted by nearness.
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
