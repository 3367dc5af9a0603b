"""The scatter renderer (DoF-Gaussian, Algorithm 1 and Eq. 6; docs/conventions.md, "Blur").

A source pixel i of radius R_i = |s_i| gives a target pixel j at distance l (between centres, pixels) the weight

    w_ij = S(R_i rho - l) / (R_i^2 + 0.2),    S(t) = 1/2 + 1/2 tanh(alpha t),

where rho is the aperture's radius factor in the direction from i to j, 1 for a disc and at l = 0; the area term is that
of the public renderers. The result is `sum_i w_ij c_i / sum_i w_ij`: order-independent, without occlusion.

A central stop of relative radius o blocks the light in the middle:

    w_ij = S(R_i rho - l) (1 - STOP_OPACITY S(o R_i rho - l)) / (R_i^2 + 0.2).

If the two edges are farther apart than their softness, this is the difference of the two confusion functions. The
product, and an opacity a little below 1, keep every weight positive; the plain difference would vanish at R = 0 and
make the division 0 / 0.
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor

from dofbench.core.lens import ALPHA, ApertureShape, Energy
from dofbench.runtime.ops import AUTO, implementation

__all__ = ["scatter"]

STOP_OPACITY = 0.999
COLOURS = 3  # channels that compiled backends process together


def scatter(
    image: Tensor,
    signed_radius: Tensor,
    *,
    alpha: float = ALPHA,
    shape: ApertureShape = ApertureShape(),
    energy: Energy = "area",
    form: Literal["auto", "direct", "linear"] = "auto",
    backend: str = AUTO,
) -> Tensor:
    """Blur `image`, (H, W, C) linear light, by `signed_radius`, (H, W) pixels; (H, W, C).

    alpha: steepness of the soft edge, 1 / pixel. energy: "area" divides by the area term, "algorithm1" doesn't. form:
    algorithm of the compiled backends, O(R^2) or O(R) a pixel, with one result; "auto" chooses by the radii; on the CPU
    "linear" takes a full disc only.

    Differentiable with respect to image and radius, with d|s|/ds = +1 at s = 0. The same input gives the same bits in
    compiled backends. A NaN in the image comes out as NaN. Raises ValueError for other shapes and options, on the CPU
    FloatingPointError for a radius that isn't finite, or so large that the area term isn't a normal number (in float32
    from 9e18 pixels); on a GPU such a radius makes the pixels that it reaches NaN, since raising would have the host
    wait for the device.
    """
    if image.ndim != 3 or 0 in image.shape:
        raise ValueError(f"image: expected shape (H, W, C) without a zero, found {tuple(image.shape)}")
    if signed_radius.shape != image.shape[:2]:
        raise ValueError(f"signed_radius: expected shape {tuple(image.shape[:2])}, found {tuple(signed_radius.shape)}")
    if not alpha > 0:
        raise ValueError(f"alpha: expected a positive number, found {alpha}")
    if energy not in ("area", "algorithm1"):
        raise ValueError(f"energy: expected 'area' or 'algorithm1', found {energy!r}")
    if form not in ("auto", "direct", "linear"):
        raise ValueError(f"form: expected 'auto', 'direct' or 'linear', found {form!r}")
    found = implementation("scatter", backend, image=image, signed_radius=signed_radius)
    return found.scatter(image, signed_radius.contiguous(), float(alpha), shape, energy == "area", form)


def in_threes(image: Tensor) -> list[Tensor]:
    """The image, (H, W, C), in groups of COLOURS channels, contiguous, the last filled up with zeros."""
    groups = []
    for first in range(0, image.shape[2], COLOURS):
        colours = image[..., first : first + COLOURS]
        if colours.shape[2] < COLOURS:
            colours = torch.nn.functional.pad(colours, (0, COLOURS - colours.shape[2]))
        groups.append(colours.contiguous())
    return groups


def joined(groups: list[Tensor], channels: int) -> Tensor:
    """The inverse of `in_threes`."""
    image = groups[0] if len(groups) == 1 else torch.cat(groups, dim=2)
    return image if image.shape[2] == channels else image[..., :channels].contiguous()


def check_largest(radius: float, kind: torch.finfo) -> None:
    """Raise FloatingPointError unless the area term of the largest radius, pixels, is a normal number.

    NaN fails too: a largest value of NaN means that some radius is NaN.
    """
    if not math.isfinite(radius):
        raise FloatingPointError("signed_radius: expected finite values, found NaN or infinity")
    if radius > kind.tiny**-0.5:
        raise FloatingPointError(f"signed_radius: expected at most {kind.tiny**-0.5:.3g} pixels, found {radius:.3g}")
