"""The definitions, in plain torch: any floating type, any device, autograd for gradients."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from dofbench.runtime.backend import Backend

from .op import LEAST_SHARES

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)


def surface(depth: Tensor, alpha: Tensor, least_alpha: float) -> Tensor:
    there = (alpha > least_alpha) & (depth > 0)
    disparity = 1 / torch.where(there, depth, 1.0)
    # Without a branch, which would have the host wait for a device.
    farthest = torch.where(there, disparity.detach(), math.inf).min()
    return torch.where(there, disparity, torch.where(farthest.isinf(), 0.0, farthest))


def circle(
    disparity: Tensor, slope: Tensor | float, offset: Tensor | float, low: float, extent: float, scale: float,
    clipped: tuple[float, float],
) -> Tensor:  # fmt: skip
    normalised = ((disparity - low) / extent).clamp(*clipped)
    return scale * (slope * normalised + offset)


def known_depth(
    depth: Tensor, alpha: Tensor, samples: tuple[Tensor, Tensor, Tensor, Tensor | None], weight: Tensor | None,
    most: int | None, least_alpha: float, extent: float | None, squared: bool,
) -> Tensor:  # fmt: skip
    rows, columns, known, shares = samples
    there = alpha[rows, columns] > least_alpha
    # Other pixels get the known depth itself instead of being skipped, since the host would have to wait for a device
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
