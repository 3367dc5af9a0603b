"""How much surfaces change their colour with the direction from which they are seen, told from the photographs.

A point's colour is compared over the views that see it, where the image around it is nearly even: there a point that is
a little off, or a blur, changes nothing, and what is left is gloss, changing light and noise. The few points at which
it is largest count, since a scene with one glossy thing needs view-dependent colours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dofbench.scenes.visibility import Seen

SMOOTHED = 1.5  # px, standard deviation: so much is looked at together
AROUND = 9  # px: within this window the image must be even, so that a blur brings nothing else in
EVEN = 0.25  # share of the points whose surroundings change least
VIEWS = 4  # that must see a point
LEAST_POINTS = 30  # that are left
MOST_POINTS = 20000  # are looked at, evenly chosen
LARGEST = 0.95  # quantile over the points


def point_colours(images: Iterable[np.ndarray], seen: Sequence[Seen]) -> tuple[np.ndarray, np.ndarray] | None:
    """What the views show of the points: colours (V, P, 3), encoded, and the image's slope around each (V, P).

    images: (H, W, 3) encoded. NaN where a view doesn't see a point; at most MOST_POINTS points. None without points.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter

    count = 1 + max((int(view.index.max()) for view in seen if len(view.index)), default=-1)
    if count == 0:
        return None
    stride = -(-count // MOST_POINTS)
    count = -(-count // stride)
    colours = np.full((len(seen), count, 3), np.nan, np.float32)
    slopes = np.full((len(seen), count), np.nan, np.float32)
    for number, (image, view) in enumerate(zip(images, seen, strict=True)):
        smooth = gaussian_filter(np.asarray(image, np.float32), (SMOOTHED, SMOOTHED, 0))
        down, along = np.gradient(smooth, axis=(0, 1))
        slope = maximum_filter(np.sqrt((down**2 + along**2).sum(axis=2)), AROUND)
        chosen = view.index % stride == 0
        index = view.index[chosen] // stride
        at = view.xy[chosen][:, ::-1].T - 0.5  # pixel centres are at half-integers
        for channel in range(3):
            colours[number, index, channel] = map_coordinates(smooth[..., channel], at, order=1, mode="nearest")
        slopes[number, index] = map_coordinates(slope, at, order=0, mode="nearest")
    return colours, slopes


def view_dependence(colours: np.ndarray, slopes: np.ndarray) -> float | None:
    """Spread of a point's colour over the views, levels of 255: its 95th percentile over points in even places.

    colours, slopes: as `point_colours` gives them. Errors of the points' places and what hides them raise it, never
    lower it. None where too few points are seen often enough.
    """
    often = np.isfinite(slopes).sum(axis=0) >= VIEWS
    if often.sum() < LEAST_POINTS / EVEN:
        return None
    colours, slope = colours[:, often], np.nanmean(slopes[:, often], axis=0)
    even = slope <= np.quantile(slope, EVEN)
    off = colours[:, even] - np.nanmedian(colours[:, even], axis=0)
    spread = np.sqrt(np.nanmean(off**2, axis=(0, 2)))
    return float(255 * np.quantile(spread, LARGEST))
