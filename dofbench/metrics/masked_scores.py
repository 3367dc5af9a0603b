"""Scores of the valid pixels of an image alone.

Masked pixels are replaced in the truth by their nearest valid ones, and in the prediction by the truth. Then an error
map is taken of the whole images, and averaged over the pixels that are valid. So nothing under a mask has an influence;
a window around a valid pixel finds both images equal where it covers masked ones.
"""

from __future__ import annotations

import numpy as np

from dofbench.core.masks import filled


def unmasked(prediction: np.ndarray, truth: np.ndarray, mask: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Both images with their masked pixels replaced; mask: (H, W) bool, True where valid, or None.

    Raises ValueError for a mask of another size, or without a valid pixel.
    """
    if mask is None:
        return prediction, truth
    if mask.shape != truth.shape[:2] or not mask.any():
        raise ValueError(f"mask: expected valid pixels of shape {truth.shape[:2]}, found {mask.shape}, {mask.sum()}")
    whole = filled(truth, mask)
    return (np.where(mask[..., None], prediction, whole) if prediction.shape == truth.shape else prediction), whole


def valid_mean(values: np.ndarray, mask: np.ndarray | None) -> float:
    """Mean of an error map (H, W, ...) over the valid pixels; of a map without its border, where windows lie inside.

    Where no window is centred on a valid pixel, all windows count.
    """
    if mask is None:
        return float(np.mean(values))
    kept = centre(mask, values)
    return float(np.mean(values[kept])) if kept.any() else float(np.mean(values))


def centre(values: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The middle of (H, W) values, as large as `like` is."""
    top, left = ((size - inner) // 2 for size, inner in zip(values.shape[:2], like.shape[:2], strict=True))
    return values[top : top + like.shape[0], left : left + like.shape[1]]
