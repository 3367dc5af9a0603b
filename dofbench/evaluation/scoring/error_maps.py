"""Error maps of predictions."""

from __future__ import annotations

import numpy as np

FULL_SCALE = 0.25  # mean absolute error over RGB, encoded, with the brightest colour
COLOURS = "magma"


def error_map(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute difference over the channels through a colour map, uint8 (H, W, 3); black is no error.

    prediction, truth: (H, W, 3), encoded, [0, 1]. Raises ValueError for different shapes.
    """
    from matplotlib import colormaps

    if prediction.shape != truth.shape:
        raise ValueError(f"error map: expected two images of one shape, found {prediction.shape} and {truth.shape}")
    error = np.abs(prediction.astype(np.float64) - truth).mean(axis=2) / FULL_SCALE
    return colormaps[COLOURS](np.clip(error, 0.0, 1.0), bytes=True)[..., :3]
