"""What EXIF says of learned apertures: a lens of focal length f at f-number N has an opening f / N wide.

An aperture (pixels x scene unit, `PhysicalLens`) is in proportion to the opening, so between photographs of one focal
length and one sensor aperture x f-number is one number, whatever the scene unit is. The thin lens brings a factor
1 / (1 - f / z) with the distance z in focus, which isn't corrected: z is known in scene units alone, and f in
millimetres; at 55 mm and 1 m in focus it is 6 %, and only its change from view to view counts.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

SMALLEST_GROUP = 3  # photographs of one f-number, for a spread or a median to mean anything
TIED = 1e-5  # relative: apertures that differ by less weren't estimated one by one, but rounded to float32
_TO_DEVIATION = 1.4826  # from the median absolute deviation to the standard deviation of a normal distribution

Estimate = tuple[float, float]  # learned aperture, f-number


@dataclass(frozen=True)
class ExifErrors:
    """spread: per cent, None with the reason in no_spread. ratio: likewise. deviation: sample standard deviation over
    the mean, per cent, of the same groups as the spread and averaged alike; None where that is."""

    spread: float | None
    ratio: float | None
    deviation: float | None
    no_spread: str = ""
    no_ratio: str = ""


def exif_errors(estimates: Sequence[Estimate]) -> ExifErrors:
    """How far learned apertures are from 1 / f-number. Apertures at one image width.

    spread: of aperture x f-number over the views of one f-number, 1.4826 x median absolute deviation / median, per
    cent; over groups of at least three views, the mean weighted by their views. ratio: of the median apertures x
    f-number of such groups, by how much the largest is above the smallest, per cent: the largest error of a ratio
    between two groups.
    """
    if not estimates:
        return ExifErrors(None, None, None, *("no learned aperture of a photograph whose f-number is known",) * 2)
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
        # If half of the apertures are still at their start, the median deviation would be zero as well.
        no_spread = "of an f-number all photographs have one aperture, or half of them: they weren't learned one by one"
    else:
        count = sum(map(len, groups.values()))
        spread = 100 * math.fsum(len(own) * _robust(own) for own in groups.values()) / count
        deviation = (
            100 * math.fsum(len(own) * statistics.stdev(own) / statistics.fmean(own) for own in groups.values()) / count
        )
    ratio, no_ratio = None, ""
    if len(groups) < 2:
        no_ratio = f"fewer than two f-numbers with {SMALLEST_GROUP} training views or more"
    elif _same([product for products in groups.values() for product in products]):
        no_ratio = "the apertures were tied by EXIF: their ratio can't be another"
    elif min(medians.values()) <= 0:
        no_ratio = "the median aperture is zero"
    else:
        ratio = 100 * (max(medians.values()) / min(medians.values()) - 1)
    return ExifErrors(spread, ratio, deviation, no_spread, no_ratio)


def _robust(values: Sequence[float]) -> float:
    median = statistics.median(values)
    return _TO_DEVIATION * statistics.median(abs(value - median) for value in values) / median


def _same(values: Sequence[float]) -> bool:
    return max(values) - min(values) <= TIED * max(abs(value) for value in values)
