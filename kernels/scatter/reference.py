"""The definition of the scatter, in plain torch: any floating type, any device, autograd for gradients.

A source pixel i of radius R_i = |s_i| gives a target pixel j at distance l (between centres, pixels)
the weight

    w_ij = S(R_i rho - l) / (R_i^2 + 0.2),    S(t) = 1/2 + 1/2 tanh(alpha t),

where rho is the aperture's radius factor in the direction from i to j, 1 for a disc and at l = 0
(DoF-Gaussian, Eq. 6, with the area term of the public renderers; docs/conventions.md, "Blur").
The result is `sum_i w_ij c_i / sum_i w_ij`: order-independent, without occlusion.

A central stop of relative radius o blocks the light in the middle:

    w_ij = S(R_i rho - l) (1 - STOP_OPACITY S(o R_i rho - l)) / (R_i^2 + 0.2).

If the two edges are farther apart than their softness, this is the difference of the two confusion functions. The
product, and an opacity a little below 1, keep every weight positive; the plain difference would vanish at R = 0 and
make the division 0 / 0.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import ALPHA, AREA_EPSILON, ApertureShape, Energy
from dofbench.runtime.backend import Backend

BACKEND = Backend(devices=("cpu", "cuda"), dtypes=("float64", "float32"), bits_repeat=False)
STOP_OPACITY = 0.999
# exp(-48) = 1e-21: a weight farther beyond the rim than 48 / (2 alpha) is negligible even in float64.
TAIL_EXPONENT = 48.0


def scatter(
    image: Tensor,
    signed_radius: Tensor,
    *,
    alpha: float = ALPHA,
    shape: ApertureShape = ApertureShape(),
    energy: Energy = "area",
    form: Literal["auto", "direct", "linear"] = "auto",
) -> Tensor:
    """Blur `image`, (H, W, C) linear light, by `signed_radius`, (H, W) pixels; (H, W, C).

    Differentiable with respect to both, with d|s|/ds = +1 at s = 0. `form` is part of the op's signature and is ignored
    here. Raises FloatingPointError for a radius that isn't finite, or so large that the area term isn't a normal number
    any more (in float32 from 9e18 pixels).
    """
    height, width, _ = image.shape
    radius = torch.where(signed_radius >= 0, signed_radius, -signed_radius)
    check_largest(float(radius.detach().max()), torch.finfo(radius.dtype))
    share = 1.0 / (radius * radius + AREA_EPSILON) if energy == "area" else torch.ones_like(radius)
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


def check(image: Tensor, signed_radius: Tensor, alpha: float, energy: str, form: str, kind: str) -> None:
    """Raise ValueError for tensors and options that no compiled backend takes. kind: of device, as torch names it."""
    if image.ndim != 3 or 0 in image.shape:
        raise ValueError(f"image: expected shape (H, W, C) without a zero, found {tuple(image.shape)}")
    if signed_radius.shape != image.shape[:2]:
        raise ValueError(f"signed_radius: expected shape {tuple(image.shape[:2])}, found {tuple(signed_radius.shape)}")
    for name, tensor in (("image", image), ("signed_radius", signed_radius)):
        if tensor.dtype != torch.float32 or tensor.device.type != kind or not tensor.is_contiguous():
            found = f"{'contiguous' if tensor.is_contiguous() else 'strided'} {tensor.dtype} on {tensor.device}"
            raise ValueError(f"{name}: expected contiguous float32 on {kind}, found {found}")
    if not alpha > 0:
        raise ValueError(f"alpha: expected a positive number, found {alpha}")
    if energy not in ("area", "algorithm1"):
        raise ValueError(f"energy: expected 'area' or 'algorithm1', found {energy!r}")
    if form not in ("auto", "direct", "linear"):
        raise ValueError(f"form: expected 'auto', 'direct' or 'linear', found {form!r}")


def check_largest(radius: float, kind: torch.finfo) -> None:
    """Raise FloatingPointError unless the area term of the largest radius, pixels, is a normal number.

    NaN fails too: a largest value of NaN means that some radius is NaN.
    """
    if not math.isfinite(radius):
        raise FloatingPointError("signed_radius: expected finite values, found NaN or infinity")
    if radius > kind.tiny**-0.5:
        raise FloatingPointError(f"signed_radius: expected at most {kind.tiny**-0.5:.3g} pixels, found {radius:.3g}")


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
