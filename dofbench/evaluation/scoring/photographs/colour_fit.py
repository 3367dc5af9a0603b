"""Affine colour correction of a prediction, so that exposure and white balance aren't scored.

It acts on encoded values. By a power law, exposure and white balance are a factor per channel of encoded values too.
"""

from __future__ import annotations

import numpy as np

from dofbench.optics.blur_width import LUMA

LOW, HIGH = 1.5 / 255, 253.5 / 255  # pixels outside are (nearly) clipped and aren't fitted
FEWEST = 64  # fewest pixels to fit 12 numbers to
FAINT = 3 / 255  # added to both standard deviations of luma: flat images have no contrast to compare


def colour_map(prediction: np.ndarray, photograph: np.ndarray) -> np.ndarray:
    """(4, 3) matrix M of the least-squares fit of [r, g, b, 1] M to the photograph's unclipped pixels.

    prediction, photograph: (P, 3), encoded. The solution closest to the identity; the identity below 64 pixels.
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
    """The image (..., 3) transformed by a `colour_map`, clipped to [0, 1], float32."""
    return np.clip(image.astype(np.float64) @ matrix[:3] + matrix[3], 0.0, 1.0).astype(np.float32)


def with_contrast(prediction: np.ndarray, photograph: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """The prediction with the photograph's mean and standard deviation of luma over the pixels `fitted`, (H, W) bool.

    prediction, photograph: (H, W, 3), encoded; returns the same, clipped to [0, 1], float64. `colour_map` lowers the
    contrast of texture that the prediction has at another place, by which it would look blurred.
    """
    own, true = (image[fitted].astype(np.float64) @ LUMA for image in (prediction, photograph))
    factor = (true.std() + FAINT) / (own.std() + FAINT)
    return np.clip((prediction - own.mean()) * factor + true.mean(), 0.0, 1.0)
