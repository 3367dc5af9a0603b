"""The definition of the scatter, in plain torch: any floating type, any device, autograd for gradients; see op.py."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import AREA_EPSILON, ApertureShape
from dofbench.runtime.backend import Backend

from .op import STOP_OPACITY, check_largest

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)
# exp(-48) = 1e-21: a weight farther beyond the rim than 48 / (2 alpha) is negligible even in float64.
TAIL_EXPONENT = 48.0


def scatter(image: Tensor, signed_radius: Tensor, alpha: float, shape: ApertureShape, area: bool, form: str) -> Tensor:
    height, width, _ = image.shape
    radius = torch.where(signed_radius >= 0, signed_radius, -signed_radius)
    check_largest(float(radius.detach().max()), torch.finfo(radius.dtype))
    share = 1.0 / (radius * radius + AREA_EPSILON) if area else torch.ones_like(radius)
    reach = math.ceil(float(radius.detach().max()) + TAIL_EXPONENT / (2.0 * alpha))

    blurred = torch.zeros_like(image)
    total = torch.zeros_like(radius)
    for dy in range(-min(reach, height - 1), min(reach, height - 1) + 1):
        rows, rows_to = _overlap(dy, height)
        for dx in range(-min(reach, width - 1), min(reach, width - 1) + 1):
            columns, columns_to = _overlap(dx, width)
            weight = _confusion(radius[rows, columns], dx, dy, alpha, shape) * share[rows, columns]
            blurred[rows_to, columns_to] += weight[..., None] * image[rows, columns]
            total[rows_to, columns_to] += weight
    return blurred / total[..., None]


def _overlap(offset: int, size: int) -> tuple[slice, slice]:
    """Sources whose target, `offset` away, lies inside the image; and these targets."""
    return slice(max(0, -offset), size - max(0, offset)), slice(max(0, offset), size + min(0, offset))


def _confusion(radius: Tensor, dx: int, dy: int, alpha: float, shape: ApertureShape) -> Tensor:
    distance = math.hypot(dx, dy)
    factor = float(shape.radius_factor(np.arctan2(dy, dx))) if distance > 0 else 1.0
    # sigmoid(2 x) is 1/2 + 1/2 tanh(x), without its cancellation where the tail is small.
    weight = torch.sigmoid(2.0 * alpha * (radius * factor - distance))
    if shape.obstruction > 0:
        weight = weight * (
            1.0 - STOP_OPACITY * torch.sigmoid(2.0 * alpha * (radius * (factor * shape.obstruction) - distance))
        )
    return weight
