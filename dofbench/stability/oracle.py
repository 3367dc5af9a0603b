"""What results are compared with: the scatter's formula written once more, in long double; and conditioning."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dofbench.core.lens import ALPHA, AREA_EPSILON, ApertureShape

# Roundings that a result may hold beside those of its inputs: a handful of operations, each of half an eps or one.
ROUNDINGS = 16.0
STOP_OPACITY = 0.999  # of a central stop (kernels/scatter/reference.py)
# How far the compiled scatter follows a soft edge (kernels/scatter/cpu_pack.py): to exp(-12) of a full weight, farther
# where most sources spread far beyond the image; a sharp source's to exp(-18).
BAND_EXPONENT, FOCUS_EXPONENT = 12.0, 18.0
POWER = 3e-6  # the compiled powers' stated relative error (kernels/tone/cpu.py)


def dense_scatter(
    image: np.ndarray,
    radius: np.ndarray,
    *,
    alpha: float = ALPHA,
    shape: ApertureShape = ApertureShape(),
    area: bool = True,
    kind: type[np.floating] = np.longdouble,
) -> np.ndarray:
    """Every pixel's weight on every pixel, in long double: (H, W, C). For small images: takes (H W)^2 numbers.

    image: (H, W, C). radius: (H, W), pixels, signed. w = S(R rho - l) / (R^2 + 0.2), S(t) = 1/2 + 1/2 tanh(alpha t)
    (docs/conventions.md, "Lens").
    """
    weight, _ = _weights(radius, alpha, shape, area, kind)
    light = weight @ image.reshape(radius.size, -1).astype(kind)
    return (light / weight.sum(axis=1, keepdims=True)).reshape(image.shape)


def left_out(
    radius: np.ndarray, *, alpha: float = ALPHA, shape: ApertureShape = ApertureShape(), area: bool = True
) -> float:
    """The largest share of a pixel's weights that lies beyond where the compiled scatter follows an edge."""
    weight, beyond = _weights(radius, alpha, shape, area, np.float64)
    spread = max(1.0, float(np.abs(radius).max()) ** 2 / radius.size)
    band = (BAND_EXPONENT + np.log(spread)) / (2 * alpha)
    tail = beyond > np.maximum(band, FOCUS_EXPONENT / (2 * alpha) - np.abs(radius.reshape(-1)))
    return float((np.where(tail, weight, 0).sum(axis=1) / weight.sum(axis=1)).max())


def _weights(
    radius: np.ndarray, alpha: float, shape: ApertureShape, area: bool, kind: type[np.floating]
) -> tuple[np.ndarray, np.ndarray]:
    """(targets, sources): weights, and how far each target lies beyond the source's radius, pixels."""
    rows, columns = (index.reshape(-1) for index in np.mgrid[: radius.shape[0], : radius.shape[1]])
    dy, dx = rows[:, None] - rows, columns[:, None] - columns
    distance = np.sqrt((dx * dx + dy * dy).astype(kind))
    size = np.abs(radius.reshape(-1).astype(kind))
    factor = np.ones(distance.shape) if shape.is_disc else shape.radius_factor(np.arctan2(dy, dx))
    factor = np.where(distance == 0, 1.0, factor)

    def inside(reach: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            return 1 / (1 + np.exp(-2 * kind(alpha) * (reach - distance)))

    weight = inside(size * factor)
    if shape.obstruction > 0:
        weight = weight * (1 - kind(STOP_OPACITY) * inside(size * factor * shape.obstruction))
    if area:
        weight = weight / (size * size + AREA_EPSILON)
    return weight, (distance - size).astype(np.float64)


def sensitivity(
    function: Callable[..., np.ndarray],
    inputs: tuple[np.ndarray, ...],
    eps: float,
    *,
    draws: int = 3,
    seed: int = 5,
    measure: Callable[[np.ndarray, np.ndarray], float] | None = None,
) -> float:
    """How much a result moves when each number that goes in is off by up to eps, relative: what rounding must cost.

    function: in a precision much finer than eps. measure: how far two results are apart, by default the largest
    deviation. The largest of some random draws. Divided by eps it is a condition number.
    """
    random = np.random.default_rng(seed)
    apart = measure or (lambda a, b: float(np.abs(a - b).max()) if a.size else 0.0)
    exact = function(*inputs)
    return max(
        apart(function(*(value * (1 + eps * random.choice((-1.0, 1.0), value.shape)) for value in inputs)), exact)
        for _ in range(draws)
    )
