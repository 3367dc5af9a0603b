"""Fits the colours of a prediction to a photograph by an affine map, so that exposure and white balance aren't scored.

The map acts on encoded values, which are the ones that are scored. Under a power-law display encoding, exposure and
white balance are a factor per channel of encoded values too.
"""

from __future__ import annotations

import numpy as np

LOW, HIGH = 1.5 / 255, 253.5 / 255  # pixels outside were clipped by the sensor, or nearly, and aren't used in the fit
FEWEST = 64  # fewest pixels to fit 12 numbers to; with fewer pixels colours aren't changed


def colour_map(prediction: np.ndarray, photograph: np.ndarray) -> np.ndarray:
    """(4, 3) matrix M that makes [r, g, b, 1] M fit the photograph best in least squares, over its pixels that aren't
    clipped.

    prediction, photograph: (P, 3), encoded. If the pixels don't determine M (for example with only one colour), the
    solution closest to the identity is taken. With fewer than 64 pixels: the identity.
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
    """(..., 3) float32: an image transformed by `colour_map`'s matrix and clipped to [0, 1]."""
    return np.clip(image.astype(np.float64) @ matrix[:3] + matrix[3], 0.0, 1.0).astype(np.float32)
