"""FLIP, the error that is seen when two images are flipped back and forth.

Source: Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: a difference
evaluator for alternating images", HPG 2020; computed by its authors' package.
"""

from __future__ import annotations

import math

import numpy as np

from dofbench.metrics._images import checked

# The authors' default: a display 3840 pixels wide, seen from as far away as it is wide.
PIXELS_PER_DEGREE = 3840 * math.pi / 180


def flip(prediction: np.ndarray, truth: np.ndarray) -> float:
    """Mean of the LDR-FLIP error map, 0 ... 1, at 67 pixels per degree.

    prediction, truth: (H, W, 3), encoded (taken as sRGB), [0, 1]. Raises ValueError for shapes
    that don't fit.
    """
    # The package turns a NaN pixel into a finite error.
    if np.isnan(prediction).any() or np.isnan(truth).any():
        checked(prediction, truth)
        return math.nan
    # The package's own mean is summed up in float32.
    return float(np.mean(flip_map(prediction, truth), dtype=np.float64))


def flip_map(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(H, W) float32: what `flip` is the mean of; arguments as there, without NaN."""
    checked(prediction, truth)
    import flip_evaluator

    reference, test = (np.ascontiguousarray(image, dtype=np.float32) for image in (truth, prediction))
    errors, _, _ = flip_evaluator.evaluate(
        reference, test, "LDR", applyMagma=False, computeMeanError=False, parameters={"ppd": PIXELS_PER_DEGREE}
    )
    return np.asarray(errors, dtype=np.float32).reshape(truth.shape[:2])
