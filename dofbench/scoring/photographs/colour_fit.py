"""Colours of a prediction turned into a photograph's by an affine map: exposure and white balance aren't scored.

On encoded values: under a display encoding that is a power, a change of exposure or of white balance is a factor a
channel there too, and it is encoded values that are scored.
"""

from __future__ import annotations

import numpy as np

LOW, HIGH = 1.5 / 255, 253.5 / 255  # what lies beyond was clipped by the sensor, or nearly: no word about colour
FEWEST = 64  # pixels to fit 12 numbers to; with fewer, colours stay as they are


def colour_map(prediction: np.ndarray, photograph: np.ndarray) -> np.ndarray:
    """(4, 3) matrix M with [r, g, b, 1] M nearest to the photograph in squares, over its pixels that aren't clipped.

    prediction, photograph: (P, 3), encoded. Where the pixels don't decide (one colour only), the change from the
    identity is the smallest. With fewer than 64 pixels: the identity.
    """
    identity = np.eye(4, 3)
    good = np.all((photograph > LOW) & (photograph < HIGH), axis=1)
    if np.count_nonzero(good) < FEWEST:
        return identity
    x = np.concatenate([prediction[good], np.ones((np.count_nonzero(good), 1))], axis=1, dtype=np.float64)
    residual = photograph[good] - x[:, :3]
    change, *_ = np.linalg.lstsq(x.T @ x, x.T @ residual, rcond=1e-9)
    return identity + change


def recoloured(image: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(..., 3) float32: an image through `colour_map`'s matrix, kept in [0, 1]."""
    return np.clip(image.astype(np.float64) @ matrix[:3] + matrix[3], 0.0, 1.0).astype(np.float32)
