"""How far photographs differ in exposure and white balance, told from the points that they share, and from EXIF.

A photograph's factor on a channel is the ratio that all its points have in common to the same points in other
photographs. Medians find it, as a point that is hidden, glossy or a little off changes no median.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dofbench.core.image_files.exif import Exif

DARKEST, BRIGHTEST = 10 / 255, 245 / 255  # colours between which a ratio says something: above noise, not clipped
LEAST_SHARED = 20  # points that a photograph must share with others
LEAST_VIEWS = 3  # photographs with enough shared points, below which nothing is said
ROUNDS = 20  # of medians over points and over photographs in turn


def view_gains(colours: np.ndarray) -> np.ndarray:
    """(V, 3) natural logarithm of each photograph's factor on encoded colours, median 0; NaN where it isn't told.

    colours: (V, P, 3), encoded, NaN where a view doesn't see a point (`point_colours`). The rounds are Tukey's median
    polish of the logarithms into a photograph's part and a point's part.
    """
    with np.errstate(invalid="ignore"):
        usable = ((colours > DARKEST) & (colours < BRIGHTEST)).all(axis=2)
    usable &= usable.sum(axis=0) >= 2
    usable &= usable.sum(axis=1)[:, None] >= LEAST_SHARED
    usable &= usable.sum(axis=0) >= 2  # without the photographs that share too few
    told = usable.any(axis=1)
    gains = np.full((len(colours), 3), np.nan)
    if told.sum() < LEAST_VIEWS:
        return gains
    view, point = (np.unique(index, return_inverse=True)[1] for index in np.nonzero(usable))
    for channel in range(3):
        left = np.log(colours[..., channel][usable]).astype(np.float32)
        found = np.zeros(int(told.sum()))
        for _ in range(ROUNDS):
            left -= _medians(left, point)[point]
            step = _medians(left, view)
            left -= step[view]
            found += step
        gains[told, channel] = found - np.median(found)
    return gains


def _medians(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    """(G,) median of each group's values, (N,) float32. group: (N,) 0 ... G - 1, each with a member.

    One sort of whole numbers does for all groups: above the group, below the value's bits, turned so that they sort as
    the values do.
    """
    bits = values.view(np.uint32)
    negative = bits >> np.uint32(31) == 1
    keys = group.astype(np.uint64) << np.uint64(32) | np.where(negative, ~bits, bits | np.uint32(1 << 31))
    keys.sort()
    bits = keys.astype(np.uint32)
    ordered = np.where(bits >> np.uint32(31) == 1, bits ^ np.uint32(1 << 31), ~bits).view(np.float32)
    ends = np.cumsum(np.bincount(group))
    starts = np.append(0, ends[:-1])
    low, high = starts + (ends - starts - 1) // 2, starts + (ends - starts) // 2
    middle: np.ndarray = (ordered[low] + ordered[high]) * np.float32(0.5)
    return middle


def colour_spread(colours: np.ndarray) -> float | None:
    """Standard deviation of the photographs' factors, per cent, of the channel where it is largest; None untold.

    colours: as in `view_gains`.
    """
    gains = view_gains(colours)
    told = np.isfinite(gains).all(axis=1)
    return float(100 * gains[told].std(axis=0).max()) if told.any() else None


def light_spread(records: Sequence[Exif | None]) -> float | None:
    """Standard deviation of the light that the cameras let in, stops; None unless EXIF says it of every photograph.

    That isn't how far the photographs themselves differ: a camera that meters lets in more light where there is less.
    """
    light = [None if record is None else record.light for record in records]
    known = [stops for stops in light if stops is not None]
    return float(np.std(np.log2(known))) if known and len(known) == len(light) else None
