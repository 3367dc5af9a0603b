"""What every image metric asks of its two images."""

from __future__ import annotations

import numpy as np


def checked(prediction: np.ndarray, truth: np.ndarray, smallest: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Both images as float64 (H, W, 3).

    Raises ValueError unless both are floating, of one shape (H, W, 3), and `smallest` pixels or
    more on the shorter side.
    """
    for name, image in (("prediction", prediction), ("truth", truth)):
        if image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"{name}: expected an image of shape (H, W, 3), found {image.shape}")
        if not np.issubdtype(image.dtype, np.floating):
            raise ValueError(f"{name}: expected floating values in [0, 1], found {image.dtype}")
    if prediction.shape != truth.shape:
        raise ValueError(f"prediction: expected the truth's shape {truth.shape}, found {prediction.shape}")
    if min(prediction.shape[:2]) < smallest:
        raise ValueError(f"prediction: expected at least {smallest} x {smallest} pixels, found {prediction.shape}")
    return prediction.astype(np.float64), truth.astype(np.float64)
