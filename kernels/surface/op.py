"""The disparity of a rendered view's surface, its circles of confusion, and the error of its depth."""

from __future__ import annotations

import math

from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["surface", "circle", "known_depth"]  # noqa: RUF022  # the op's name first, then in order of use

LEAST_SHARES = 1e-12  # divides the sum over no pixels, which is 0


def surface(depth: Tensor, alpha: Tensor, least_alpha: float, *, backend: str = AUTO) -> Tensor:
    """(H, W) disparity, 1 / scene unit, of the surface in each pixel.

    depth: (H, W) z, scene units. alpha: (H, W) accumulated opacity. A pixel has a surface if its opacity is more than
    `least_alpha` and its depth positive; any other gets the farthest surface's disparity in the image, and 0 if no
    pixel has one. Differentiable with respect to the depth of pixels with a surface, alone.
    """
    _check_shapes(depth, alpha)
    return implementation("surface", backend, depth=depth, alpha=alpha).surface(depth, alpha.detach(), least_alpha)


def circle(
    disparity: Tensor,
    slope: Tensor | float,
    offset: Tensor | float,
    *,
    low: float,
    extent: float,
    scale: float,
    clipped: tuple[float, float] = (-math.inf, math.inf),
    backend: str = AUTO,
) -> Tensor:
    """Signed circle of confusion, pixels, of disparities of any shape: scale (slope d + offset).

    d is (disparity - low) / extent, clipped to `clipped`, outside of which it has no gradient. slope, offset: scalars.
    Differentiable with respect to disparity, slope and offset.
    """
    lens = {name: one for name, one in (("slope", slope), ("offset", offset)) if isinstance(one, Tensor)}
    found = implementation("surface", backend, disparity=disparity, **lens)
    return found.circle(disparity, slope, offset, low, extent, scale, clipped)


def known_depth(
    depth: Tensor,
    alpha: Tensor,
    rows: Tensor,
    columns: Tensor,
    known: Tensor,
    shares: Tensor | None,
    weight: Tensor | None,
    *,
    most: int | None,
    least_alpha: float,
    extent: float | None,
    squared: bool,
    backend: str = AUTO,
) -> Tensor:
    """The mean error of rendered depth over the samples of known depth whose pixel has a surface; 0 where none has.

    depth: (H, W) z, scene units. alpha: (H, W) accumulated opacity; a pixel has a surface if it is more than
    `least_alpha`. rows, columns: (M,) int32 or int64, the samples' pixels, in the order of rows, then columns. known:
    (M,) z. shares: (M,) how much each counts in the mean, or None for equal shares. weight: (H, W), a factor on the
    error which the mean isn't divided by, or None. most: samples in one pixel, at most; a GPU needs it. extent: None
    for an error in scene units; else that of the disparity, in units of `extent`. squared: whether the error is
    squared, else its absolute value is taken. Differentiable with respect to depth. Raises IndexError on the CPU for
    samples outside the image.
    """
    _check_shapes(depth, alpha, weight)
    found = implementation("surface", backend, depth=depth, alpha=alpha, known=known, shares=shares, weight=weight)
    return found.known_depth(
        depth, alpha.detach(), (rows, columns, known, shares), weight, most, least_alpha, extent, squared
    )


def _check_shapes(depth: Tensor, *others: Tensor | None) -> None:
    for one in others:
        if one is not None and one.shape != depth.shape:
            raise ValueError(f"surface: expected images of {tuple(depth.shape)} pixels, found {tuple(one.shape)}")
