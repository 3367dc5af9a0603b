"""Rendered depth: no surface, degenerate disparity ranges, none or many depth samples in one pixel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from torch import Tensor

from dofbench.evaluation.stability.case import DOUBLE, KERNELS, Case, Found, Setting, Subject
from dofbench.evaluation.stability.deviation import differing, gradient_at, off
from dofbench.evaluation.stability.oracle import ROUNDINGS
from dofbench.evaluation.stability.samples import HEIGHT, WIDTH, disparity

_LEAST_ALPHA = 0.1
SIZE = HEIGHT, WIDTH


def _seen(setting: Setting, depth: np.ndarray, alpha: np.ndarray) -> tuple[Tensor, np.ndarray]:
    """The surface's disparity, and the gradient of its sum with respect to depth."""
    leaf = setting.tensor(depth, gradient=True)
    found: Tensor = setting.kernel("surface")(leaf, setting.tensor(alpha), _LEAST_ALPHA)
    found.sum().backward()
    return found, gradient_at(leaf)


def _nothing_seen(setting: Setting, depth: float) -> Found:
    """No pixel has a surface: disparity and gradient are 0."""
    found, gradient = _seen(setting, np.full(SIZE, depth), np.full(SIZE, _LEAST_ALPHA / 2))
    return Found(differing(found, np.zeros(SIZE)) + differing(gradient, np.zeros(SIZE)), 0.0)


def _one_seen(setting: Setting, depth: float) -> Found:
    """One pixel has a surface; its disparity is used everywhere."""
    z = np.full(SIZE, depth)
    z[3, 4] = 2.0
    alpha = np.where(z == 2.0, 1.0, 0.0 if depth > 0 or math.isnan(depth) else 1.0)
    found, gradient = _seen(setting, z, alpha)
    expected = np.where(z == 2.0, -0.25, 0.0)
    return Found(differing(found, np.full(SIZE, 0.5)) + differing(gradient, expected), 0.0)


def _circle(setting: Setting, **options: Any) -> tuple[Tensor, list[np.ndarray]]:
    """CoC radii of the sample disparities, and gradients with respect to disparity, slope and offset."""
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
    """Every disparity is nearer than the range: clipped to its end, so only slope and offset have a gradient."""
    found, (by_disparity, by_slope, by_offset) = _circle(setting, low=-9.0, extent=1.0, scale=8.0, clipped=(0.0, 1.0))
    count = HEIGHT * WIDTH
    wrong = differing(found, np.full(SIZE, 2.0)) + differing(by_disparity, np.zeros(SIZE))
    return Found(wrong + differing(np.concatenate([by_slope, by_offset]), np.full(2, 8.0 * count)), 0.0)


def _error(setting: Setting, count: int, alpha: float, squared: bool) -> tuple[Tensor, np.ndarray]:
    """The error of `count` samples in one pixel, and its gradient with respect to depth."""
    at = setting.tensor(np.full(count, 3)).long()
    known = setting.tensor(np.linspace(1.0, 4.0, count, dtype=np.float32))
    leaf = setting.tensor(np.full(SIZE, 2.0), gradient=True)
    opacity = setting.tensor(np.full(SIZE, alpha))
    options = {"most": max(count, 1), "least_alpha": _LEAST_ALPHA, "extent": 0.5, "squared": squared}
    found: Tensor = setting.kernel("surface", "known_depth")(leaf, opacity, at, at, known, None, None, **options)
    found.backward()
    return found, gradient_at(leaf)


def _nothing_known(setting: Setting, count: int) -> Found:
    """No sample is on a surface, or there is none: error and gradient are 0."""
    found, gradient = _error(setting, count, 0.0, False)
    return Found(differing(found, np.zeros(())) + differing(gradient, np.zeros(SIZE)), 0.0)


def _crowded(setting: Setting, squared: bool) -> Found:
    """More samples in one pixel than one GPU program processes."""
    count = 1025
    (found, gradient), (exact, expected) = (_error(one, count, 1.0, squared) for one in (setting, DOUBLE))
    return Found(max(off(found, exact), off(gradient, expected)), (2 * ROUNDINGS + count) * setting.eps)


def surfaces() -> tuple[Case, ...]:
    """The cases, for the group "lens"."""
    surface = Subject("lens", "surface", KERNELS)
    nan, infinite = math.nan, math.inf
    return (
        *surface.each("surface-none-{depth_label}", _nothing_seen, depth={"2": 2.0, "0": 0.0, "nan": nan}),
        *surface.each(
            "surface-one-{depth_label}",
            _one_seen,
            depth={"negative": -2.0, "0": 0.0, "infinite": infinite, "nan": nan},
        ),
        *surface.each("circle-range-{extent:g}", _range, extent=(1e-6, 1.0, 1e6)),
        surface.case("circle-beyond-range", _beyond_the_range),
        *surface.each("known-depth-none-of-{count}", _nothing_known, count=(0, 5)),
        *surface.each("known-depth-crowded-{squared_label}", _crowded, squared={"absolute": False, "squared": True}),
    )
