"""Error maps: pictures that show where a prediction is wrong."""

from __future__ import annotations

import numpy as np

FULL_SCALE = 0.25  # mean absolute error over RGB, encoded, from which on the brightest colour is used
COLOURS = "magma"  # perceptually uniform and readable without colour vision


def error_map(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute difference over the channels, through a colour map.

    prediction, truth: (H, W, 3), encoded, [0, 1]. Returns uint8 (H, W, 3): black is no error, the
    lightest colour `FULL_SCALE` or more. Raises ValueError when the shapes differ.
    """
    from matplotlib import colormaps

    if prediction.shape != truth.shape:
        raise ValueError(f"error map: expected two images of one shape, found {prediction.shape} and {truth.shape}")
    error = np.abs(prediction.astype(np.float64) - truth).mean(axis=2) / FULL_SCALE
    return colormaps[COLOURS](np.clip(error, 0.0, 1.0), bytes=True)[..., :3]
