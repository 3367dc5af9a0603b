"""Reference values: an independent implementation of the scatter's formula in long double; condition numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dofbench.core.lens import ALPHA, AREA_EPSILON, ApertureShape

# Roundings allowed in a result in addition to those of its inputs: a few operations, each of half an eps or one.
ROUNDINGS = 16.0
STOP_OPACITY = 0.999  # opacity of a central stop (kernels/scatter/reference.py)
# The compiled scatter truncates a soft edge (kernels/scatter/cpu_pack.py) at exp(-12) of a full weight, and farther out
# if most sources spread far beyond the image; the edge of a sharp source at exp(-18).
BAND_EXPONENT, FOCUS_EXPONENT = 12.0, 18.0
POWER = 3e-6  # relative error that kernels/tone/cpu.py states for the compiled powers


def dense_scatter(
    image: np.ndarray,
    radius: np.ndarray,
    *,
    alpha: float = ALPHA,
    shape: ApertureShape = ApertureShape(),
    area: bool = True,
    kind: type[np.floating] = np.longdouble,
) -> np.ndarray:
    """The scatter by the weights of every pixel on every pixel: (H, W, C). Needs memory for (H W)^2 numbers.

    image: (H, W, C). radius: (H, W), pixels, signed. w = S(R rho - l) / (R^2 + 0.2), S(t) = 1/2 + 1/2 tanh(alpha t)
    (docs/conventions.md, "Lens").
    """
    weight, _ = _weights(radius, alpha, shape, area, kind)
    light = weight @ image.reshape(radius.size, -1).astype(kind)
    return (light / weight.sum(axis=1, keepdims=True)).reshape(image.shape)


def left_out(
    radius: np.ndarray, *, alpha: float = ALPHA, shape: ApertureShape = ApertureShape(), area: bool = True
) -> float:
    """The largest share of a pixel's weights that the compiled scatter truncates."""
    weight, beyond = _weights(radius, alpha, shape, area, np.float64)
    spread = max(1.0, float(np.abs(radius).max()) ** 2 / radius.size)
    band = (BAND_EXPONENT + np.log(spread)) / (2 * alpha)
    tail = beyond > np.maximum(band, FOCUS_EXPONENT / (2 * alpha) - np.abs(radius.reshape(-1)))
    return float((np.where(tail, weight, 0).sum(axis=1) / weight.sum(axis=1)).max())


def _weights(
    radius: np.ndarray, alpha: float, shape: ApertureShape, area: bool, kind: type[np.floating]
) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays (targets, sources): the weights, and the target's distance beyond the source's radius, pixels."""
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
    """The largest change of a result when every input has a relative error of eps: divided by eps, a condition number.

    The maximum over `draws` random perturbations. function: computes in a precision much finer than eps. measure:
    distance of two results, by default the largest deviation.
    """
    random = np.random.default_rng(seed)
    apart = measure or (lambda a, b: float(np.abs(a - b).max()) if a.size else 0.0)
    exact = function(*inputs)
    return max(
        apart(function(*(value * (1 + eps * random.choice((-1.0, 1.0), value.shape)) for value in inputs)), exact)
        for _ in range(draws)
    )
