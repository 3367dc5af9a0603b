"""What a rendered depth says: surfaces without depth, ranges of disparity without extent, samples of known depth that
crowd in one pixel or have none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from torch import Tensor

from dofbench.evaluation.stability.case import DOUBLE, KERNELS, Case, Found, Setting, differing, gradient_at, off
from dofbench.evaluation.stability.comparisons import EXACT
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, disparity
from dofbench.evaluation.stability.subject import Subject

_LEAST_ALPHA = 0.1
_AS_DEFINED = "32 roundings"


def _seen(setting: Setting, depth: np.ndarray, alpha: np.ndarray) -> tuple[Tensor, np.ndarray]:
    """The surface's disparity, and the gradient of its sum by depth."""
    leaf = setting.tensor(depth, gradient=True)
    found: Tensor = setting.kernel("surface")(leaf, setting.tensor(alpha), _LEAST_ALPHA)
    found.sum().backward()
    return found, gradient_at(leaf)


def _nothing_seen(setting: Setting, depth: float) -> Found:
    """No pixel has a surface: all are infinitely far, and nothing is learned."""
    found, gradient = _seen(setting, np.full((HEIGHT, WIDTH), depth), np.full((HEIGHT, WIDTH), _LEAST_ALPHA / 2))
    return Found(differing(found, np.zeros((HEIGHT, WIDTH))) + differing(gradient, np.zeros((HEIGHT, WIDTH))), 0.0)


def _one_seen(setting: Setting, depth: float) -> Found:
    """One pixel has a surface, which stands for all, whatever depth the others have."""
    z = np.full((HEIGHT, WIDTH), depth)
    z[3, 4] = 2.0
    alpha = np.where(z == 2.0, 1.0, 0.0 if depth > 0 or math.isnan(depth) else 1.0)
    found, gradient = _seen(setting, z, alpha)
    expected = np.where(z == 2.0, -0.25, 0.0)
    return Found(differing(found, np.full((HEIGHT, WIDTH), 0.5)) + differing(gradient, expected), 0.0)


def _circle(setting: Setting, **options: Any) -> tuple[Tensor, list[np.ndarray]]:
    """Circles of confusion of the picture's disparities, and gradients by disparity, slope and offset."""
    given = [setting.tensor(value, gradient=True) for value in (disparity().astype(np.float32), 0.5, -0.25)]
    found: Tensor = setting.kernel("surface", "circle")(*given, **options)
    found.sum().backward()
    return found, [gradient_at(one) for one in given]


def _range(setting: Setting, extent: float) -> Found:
    """Subtracting the far end loses as many digits as it is larger than the extent."""
    options = {"low": 0.25, "extent": extent, "scale": 10.0}
    (found, gradients), (exact, expected) = (_circle(one, **options) for one in (setting, DOUBLE))
    worst = max(off(one, other) for one, other in zip(gradients, expected, strict=True))
    return Found(max(worst, off(found, exact)), (2 * ROUNDINGS + HEIGHT * WIDTH) * setting.eps)


def _beyond_the_range(setting: Setting) -> Found:
    """Every disparity is nearer than the range: its near end stands for it, and only the lens learns."""
    found, (by_disparity, by_slope, by_offset) = _circle(setting, low=-9.0, extent=1.0, scale=8.0, clipped=(0.0, 1.0))
    count = HEIGHT * WIDTH
    wrong = differing(found, np.full((HEIGHT, WIDTH), 2.0)) + differing(by_disparity, np.zeros((HEIGHT, WIDTH)))
    return Found(wrong + differing(np.concatenate([by_slope, by_offset]), np.full(2, 8.0 * count)), 0.0)


def _error(setting: Setting, count: int, alpha: float, squared: bool) -> tuple[Tensor, np.ndarray]:
    """The error of `count` samples in one pixel, and its gradient by depth."""
    at = setting.tensor(np.full(count, 3)).long()
    known = setting.tensor(np.linspace(1.0, 4.0, count, dtype=np.float32))
    leaf = setting.tensor(np.full((HEIGHT, WIDTH), 2.0), gradient=True)
    opacity = setting.tensor(np.full((HEIGHT, WIDTH), alpha))
    options = {"most": max(count, 1), "least_alpha": _LEAST_ALPHA, "extent": 0.5, "squared": squared}
    found: Tensor = setting.kernel("surface", "known_depth")(leaf, opacity, at, at, known, None, None, **options)
    found.backward()
    return found, gradient_at(leaf)


def _nothing_known(setting: Setting, count: int) -> Found:
    """No sample lies on a surface, or there is none: no error, and nothing is learned."""
    found, gradient = _error(setting, count, 0.0, False)
    return Found(differing(found, np.zeros(())) + differing(gradient, np.zeros((HEIGHT, WIDTH))), 0.0)


def _crowded(setting: Setting, squared: bool) -> Found:
    """A thousand samples in one pixel, more than one program of a GPU's takes."""
    count = 1025
    (found, gradient), (exact, expected) = (_error(one, count, 1.0, squared) for one in (setting, DOUBLE))
    return Found(max(off(found, exact), off(gradient, expected)), (2 * ROUNDINGS + count) * setting.eps)


def surfaces() -> tuple[Case, ...]:
    """The cases of the lens's group."""
    surface = Subject("lens", "surface", KERNELS)
    summed = _AS_DEFINED + ", and one for each pixel that is added up"
    return (
        *surface.each(
            "surface-none-{depth_label}",
            "a depth of {depth} without opacity is infinitely far, and isn't learned",
            EXACT,
            _nothing_seen,
            depth={"2": 2.0, "0": 0.0, "nan": math.nan},
        ),
        *surface.each(
            "surface-one-{depth_label}",
            "one surface stands for all pixels, whose depth is {depth}",
            EXACT,
            _one_seen,
            depth={"negative": -2.0, "0": 0.0, "infinite": math.inf, "nan": math.nan},
        ),
        *surface.each(
            "circle-range-{extent:g}",
            "circles of confusion and gradients are the definition's in a range {extent:g} wide",
            summed,
            _range,
            extent=(1e-6, 1.0, 1e6),
        ),
        surface.case(
            "circle-beyond-range", "disparities nearer than their range are its end, without gradient", EXACT,
            _beyond_the_range,
        ),
        *surface.each(
            "known-depth-none-of-{count}",
            "{count} samples without a surface have no error, and nothing is learned",
            EXACT,
            _nothing_known,
            count=(0, 5),
        ),
        *surface.each(
            "known-depth-crowded-{squared_label}",
            "1025 samples in one pixel add up, error {squared_label}",
            _AS_DEFINED + ", and one for each sample",
            _crowded,
            squared={"absolute": False, "squared": True},
        ),
    )  # fmt: skip
