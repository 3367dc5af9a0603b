"""The definitions, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)
LEAST_SHARES = 1e-12  # divides the sum over no pixels, which is 0


def surface(depth: Tensor, alpha: Tensor, least_alpha: float) -> Tensor:
    """(H, W) disparity, 1 / scene unit, of the surface in each pixel.

    depth: (H, W) z, scene units. alpha: (H, W) accumulated opacity. A pixel has a surface if its opacity is more than
    `least_alpha` and its depth positive; any other gets the farthest surface's disparity in the image, and 0 if no
    pixel has one. Differentiable with respect to the depth of pixels with a surface, alone.
    """
    there = (alpha > least_alpha) & (depth > 0)
    disparity = 1 / torch.where(there, depth, 1.0)
    # Without a branch, which would have the host wait for a device.
    farthest = torch.where(there, disparity.detach(), math.inf).min()
    return torch.where(there, disparity, torch.where(farthest.isinf(), 0.0, farthest))


def circle(
    disparity: Tensor,
    slope: Tensor | float,
    offset: Tensor | float,
    *,
    low: float,
    extent: float,
    scale: float,
    clipped: tuple[float, float] = (-math.inf, math.inf),
) -> Tensor:
    """Signed circle of confusion, pixels, of disparities of any shape: scale (slope d + offset).

    d is (disparity - low) / extent, clipped to `clipped`, outside of which it has no gradient. slope, offset: scalars.
    Differentiable with respect to disparity, slope and offset.
    """
    normalised = ((disparity - low) / extent).clamp(*clipped)
    return scale * (slope * normalised + offset)


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
) -> Tensor:
    """The mean error of rendered depth over the samples of known depth whose pixel has a surface; 0 where none has.

    depth: (H, W) z, scene units. alpha: (H, W) accumulated opacity; a pixel has a surface if it is more than
    `least_alpha`. rows, columns: (M,) int64, the samples' pixels, in the order of rows, then columns. known: (M,) z.
    shares: (M,) how much each counts in the mean, or None for equal shares. weight: (H, W), a factor on the error which
    the mean isn't divided by, or None. most: samples in one pixel, at most; None if unknown, which a backend may refuse
    with ValueError. extent: None for an error in scene units; else that of the disparity, in units of `extent`.
    squared: whether the error is squared, else its absolute value is taken. Differentiable with respect to depth.
    """
    there = alpha.detach()[rows, columns] > least_alpha
    # Other pixels get the known depth itself instead of being left out, since the host would have to wait for a device
    # to know how many they are.
    rendered = torch.where(there, depth[rows, columns], known)
    difference = rendered - known if extent is None else (1 / rendered - 1 / known) / extent
    error = difference.square() if squared else difference.abs()
    if shares is not None:
        error = error * shares
    if weight is not None:
        error = error * weight[rows, columns]
    counted = there.to(error.dtype) if shares is None else there * shares
    return error.sum() / counted.sum().clamp(min=LEAST_SHARES)


def check_shapes(depth: Tensor, *others: Tensor | None) -> None:
    """Raise ValueError unless all pictures have the size of the depth."""
    for one in others:
        if one is not None and one.shape != depth.shape:
            raise ValueError(f"surface: expected pictures of {tuple(depth.shape)} pixels, found {tuple(one.shape)}")
