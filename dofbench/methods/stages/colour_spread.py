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
    points = usable.any(axis=0)
    left = np.log(np.where(usable[..., None], colours, np.nan)[told][:, points])
    found = np.zeros((int(told.sum()), 3))
    for _ in range(ROUNDS):
        left -= np.nanmedian(left, axis=0)
        step = np.nanmedian(left, axis=1)
        left -= step[:, None]
        found += step
    gains[told] = found - np.median(found, axis=0)
    return gains


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
