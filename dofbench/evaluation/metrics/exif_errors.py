"""Learned lenses against EXIF: apertures against f-numbers, foci against focus distances.

A lens of focal length f at f-number N has an opening f / N wide. An aperture (pixels x scene unit, `PhysicalLens`) is
proportional to the opening, so aperture x f-number is one number for images of one focal length and one sensor,
whatever the scene unit. The thin lens's factor 1 / (1 - f / z) with the focus distance z isn't corrected: z is known in
scene units only. At 55 mm and 1 m it is 6 %, and only its change between views matters.

EXIF has focus distances in metres, the learned focus is in scene units, and their ratio is unknown. Both are compared
as disparities: infinity is zero, and equal differences blur equally. An offset is fitted besides the scale, because
cameras measure the distance by the lens's travel, whose zero is uncertain.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SMALLEST_GROUP = 3  # views of one f-number, for a meaningful spread or median
SMALLEST_SET = 5  # views, for a meaningful correlation or scatter about a line
SMALLEST_STEPS = 3  # different distances: two are always on a line
TIED = 1e-5  # relative: values that differ by less are one shared value, rounded to float32
RESAMPLINGS, _SEED = 1000, 0  # of the bootstrap
_TO_DEVIATION = 1.4826  # from the median absolute deviation to the standard deviation of a normal distribution

Estimate = tuple[float, float]  # learned aperture, f-number
Interval = tuple[float, float]
FocusEstimate = tuple[float, float]  # learned focus, 1 / scene unit; focus distance, m, inf for infinity


@dataclass(frozen=True)
class ExifErrors:
    """spread, ratio: per cent; None with the reason in no_spread, no_ratio. deviation: sample standard deviation over
    the mean, per cent, averaged as the spread; None where the spread is."""

    spread: float | None
    ratio: float | None
    deviation: float | None
    no_spread: str = ""
    no_ratio: str = ""


def exif_errors(estimates: Sequence[Estimate]) -> ExifErrors:
    """How far learned apertures, at one image width, are from 1 / f-number.

    spread: 1.4826 x median absolute deviation / median of aperture x f-number over the views of one f-number, per cent;
    mean over groups of at least three views, weighted by views. ratio: largest over smallest median of these groups,
    minus 1, per cent: the largest error of a ratio between two groups.
    """
    if not estimates:
        return ExifErrors(None, None, None, *("no learned aperture of a view with a known f-number",) * 2)
    groups: dict[float, list[float]] = {}
    for aperture, f_number in estimates:
        groups.setdefault(f_number, []).append(aperture * f_number)
    groups = {number: products for number, products in groups.items() if len(products) >= SMALLEST_GROUP}
    if not groups:
        return ExifErrors(None, None, None, *(f"no f-number has {SMALLEST_GROUP} training views or more",) * 2)
    spread, deviation, no_spread = None, None, ""
    medians = {number: statistics.median(products) for number, products in groups.items()}
    if min(medians.values()) <= 0:
        no_spread = "the median aperture is zero"
    elif any(_robust(products) <= TIED for products in groups.values()):
        # The median deviation is zero as well if half of the apertures still have their initial value.
        no_spread = "all views of an f-number share one aperture, or half of them: not learned per view"
    else:
        count = sum(map(len, groups.values()))
        spread = 100 * math.fsum(len(own) * _robust(own) for own in groups.values()) / count
        weighted = [len(own) * statistics.stdev(own) / statistics.fmean(own) for own in groups.values()]
        deviation = 100 * math.fsum(weighted) / count
    ratio, no_ratio = None, ""
    if len(groups) < 2:
        no_ratio = f"fewer than two f-numbers with {SMALLEST_GROUP} training views or more"
    elif _same([product for products in groups.values() for product in products]):
        no_ratio = "the apertures are tied by EXIF, so their ratio is fixed"
    elif min(medians.values()) <= 0:
        no_ratio = "the median aperture is zero"
    else:
        ratio = 100 * (max(medians.values()) / min(medians.values()) - 1)
    return ExifErrors(spread, ratio, deviation, no_spread, no_ratio)


@dataclass(frozen=True)
class ExifIntervals:
    """95 % intervals: of spread and ratio, per cent, as `ExifErrors`, and of the median of aperture x f-number over all
    views; None where there is no such score, or no view."""

    spread: Interval | None
    ratio: Interval | None
    product: Interval | None


def exif_intervals(estimates: Sequence[Estimate]) -> ExifIntervals:
    """How far the scores of `exif_errors` are certain: percentile bootstrap over the views of each f-number, 1 000
    resamplings by a fixed seed. The views of one training share its errors, which no resampling shows."""
    whole = exif_errors(estimates)
    groups: dict[float, list[float]] = {}
    for aperture, f_number in estimates:
        groups.setdefault(f_number, []).append(aperture * f_number)
    if not groups:
        return ExifIntervals(None, None, None)
    random = np.random.default_rng(_SEED)
    drawn = {
        number: np.array(own)[random.integers(len(own), size=(RESAMPLINGS, len(own)))] for number, own in groups.items()
    }
    large = [products for products in drawn.values() if products.shape[1] >= SMALLEST_GROUP]
    medians = [np.median(products, axis=1) for products in large]
    spread = ratio = None
    if whole.spread is not None:
        robust = [
            _TO_DEVIATION * np.median(np.abs(products - middle[:, None]), axis=1) / middle
            for products, middle in zip(large, medians, strict=True)
        ]
        spread = _interval(100 * np.average(robust, axis=0, weights=[products.shape[1] for products in large]))
    if whole.ratio is not None:
        ratio = _interval(100 * (np.max(medians, axis=0) / np.min(medians, axis=0) - 1))
    return ExifIntervals(spread, ratio, _interval(np.median(np.concatenate(list(drawn.values()), axis=1), axis=1)))


def _interval(values: np.ndarray) -> Interval:
    low, high = np.quantile(values, (0.025, 0.975))
    return float(low), float(high)


def _robust(values: Sequence[float]) -> float:
    median = statistics.median(values)
    return _TO_DEVIATION * statistics.median(abs(value - median) for value in values) / median


def _same(values: Sequence[float]) -> bool:
    return max(values) - min(values) <= TIED * max(abs(value) for value in values)


@dataclass(frozen=True)
class ExifFocusErrors:
    """rank: rank correlation, -1 to 1; None with its reason. scatter: per cent; None with no_scatter."""

    rank: float | None
    scatter: float | None
    reason: str = ""
    no_scatter: str = ""


def too_few_distances(distances: Sequence[float]) -> str:
    """Why these distances can't be compared, one line; "" if they can."""
    if not distances:
        return "no training view has a focus distance in its EXIF"
    if len(distances) < SMALLEST_SET:
        return f"fewer than {SMALLEST_SET} training views have a focus distance in their EXIF"
    if len(set(distances)) < SMALLEST_STEPS:
        return f"the training views have fewer than {SMALLEST_STEPS} different focus distances in their EXIF"
    return ""


def exif_focus_errors(estimates: Sequence[FocusEstimate]) -> ExifFocusErrors:
    """How far learned focus disparities q are from a line over EXIF's disparities 1 / distance.

    rank: Spearman's correlation of q and 1 / distance. scatter: standard deviation (n - 2 degrees of freedom) of q
    about scale x (1 / distance) + offset by least squares, scale >= 0, over the mean q, per cent.
    """
    from scipy.stats import rankdata

    if why := too_few_distances([distance for _, distance in estimates]):
        return ExifFocusErrors(None, None, why, why)
    learned, distances = np.array(estimates, np.float64).T
    if not np.isfinite(learned).all():
        return ExifFocusErrors(None, None, *("a learned focus isn't finite",) * 2)
    if np.ptp(learned) <= TIED * np.abs(learned).max():
        return ExifFocusErrors(None, None, *("all views have one learned focus",) * 2)
    written = 1 / distances
    rank = float(np.corrcoef(rankdata(learned), rankdata(written))[0, 1])
    if learned.mean() <= 0:
        return ExifFocusErrors(rank, None, no_scatter="the mean learned focus is beyond infinity")
    from_mean = written - written.mean()
    scale = max(0.0, float(from_mean @ learned / (from_mean @ from_mean)))
    residual = learned - learned.mean() - scale * from_mean
    scatter = 100 * float(np.sqrt(residual @ residual / (len(learned) - 2)) / learned.mean())
    return ExifFocusErrors(rank, scatter)
