"""How learned focus distances agree with EXIF's.

A camera writes the distance in focus in metres, the learned focus is in scene units, and their ratio is unknown. Both
are compared as disparities: there infinity is zero, a learned focus beyond infinity is negative, and equal differences
blur equally. An offset is allowed beside the scale, as cameras tell the distance by the lens's travel, whose zero is
uncertain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SMALLEST_SET = 5  # photographs, for a correlation or a scatter about a line to mean anything
SMALLEST_STEPS = 3  # different distances: two are always on a line
TIED = 1e-5  # relative: foci that differ by less weren't estimated one by one, but rounded to float32

FocusEstimate = tuple[float, float]  # learned focus, 1 / scene unit; distance in focus, m, inf for infinity


@dataclass(frozen=True)
class ExifFocusErrors:
    """rank: correlation of the ranks, -1 to 1. scatter: per cent. Both None with the reason in `reason`, the scatter
    alone with that in no_scatter."""

    rank: float | None
    scatter: float | None
    reason: str = ""
    no_scatter: str = ""


def too_few_distances(distances: Sequence[float]) -> str:
    """Why these distances can't be compared with anything, one line; "" if they can."""
    if not distances:
        return "no training photograph has a focus distance in its EXIF"
    if len(distances) < SMALLEST_SET:
        return f"fewer than {SMALLEST_SET} training photographs have a focus distance in their EXIF"
    if len(set(distances)) < SMALLEST_STEPS:
        return f"the training photographs have fewer than {SMALLEST_STEPS} different focus distances in their EXIF"
    return ""


def exif_focus_errors(estimates: Sequence[FocusEstimate]) -> ExifFocusErrors:
    """How far learned focus disparities q are from a line over the disparities 1 / distance of EXIF.

    rank: Spearman's correlation of q and 1 / distance; equal values share the mean of their ranks. scatter: standard
    deviation (n - 2 degrees of freedom) of q about its best scale x (1 / distance) + offset by least squares, the scale
    not negative, over the mean q, per cent: about the relative error of a distance.
    """
    from scipy.stats import rankdata

    if why := too_few_distances([distance for _, distance in estimates]):
        return ExifFocusErrors(None, None, why, why)
    learned, distances = np.array(estimates, np.float64).T
    if not np.isfinite(learned).all():
        return ExifFocusErrors(None, None, *("a learned focus isn't finite",) * 2)
    if np.ptp(learned) <= TIED * np.abs(learned).max():
        return ExifFocusErrors(None, None, *("all photographs have one learned focus",) * 2)
    written = 1 / distances
    rank = float(np.corrcoef(rankdata(learned), rankdata(written))[0, 1])
    if learned.mean() <= 0:
        return ExifFocusErrors(rank, None, no_scatter="the mean learned focus lies beyond infinity")
    from_mean = written - written.mean()
    scale = max(0.0, float(from_mean @ learned / (from_mean @ from_mean)))
    residual = learned - learned.mean() - scale * from_mean
    scatter = 100 * float(np.sqrt(residual @ residual / (len(learned) - 2)) / learned.mean())
    return ExifFocusErrors(rank, scatter)
