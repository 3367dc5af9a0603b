"""The scatter on a CPU: float32, numba, two forms with one result (see reference.py for the definition)."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.lens import ALPHA, ApertureShape, Energy

from . import cpu_direct, cpu_direct_backward
from .cpu_linear import prefix_sums
from .cpu_pack import COLOURS, PLANES, RATIONAL, SUMS, edges, geometry, pack_sources

# Largest radius, pixels, from which "auto" takes the linear form.
LINEAR_FROM = 12.0
_NO_PREFIX = np.empty(0, np.float64)


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

    float32 on the CPU, contiguous. Differentiable by both, with d|s|/ds = +1 at s = 0. The same
    input gives the same bits, whatever the number of threads. Raises ValueError for anything
    else than such tensors and for options that don't exist, FloatingPointError for a radius
    that isn't finite; a NaN in the image comes out as NaN.
    """
    _check(image, signed_radius, alpha, energy, form)
    height, width, channels = image.shape
    groups = []
    for first in range(0, channels, COLOURS):
        colours = image[..., first:first + COLOURS]
        if colours.shape[2] < COLOURS:
            colours = torch.nn.functional.pad(colours, (0, COLOURS - colours.shape[2]))
        groups.append(_Scatter.apply(colours.contiguous(), signed_radius, alpha, shape, energy == "area", form))
    blurred = groups[0] if len(groups) == 1 else torch.cat(groups, dim=2)
    return blurred if blurred.shape[2] == channels else blurred[..., :channels].contiguous()


def _check(image: Tensor, signed_radius: Tensor, alpha: float, energy: str, form: str) -> None:
    if image.ndim != 3 or 0 in image.shape:
        raise ValueError(f"image: expected shape (H, W, C) without a zero, found {tuple(image.shape)}")
    if signed_radius.shape != image.shape[:2]:
        raise ValueError(f"signed_radius: expected shape {tuple(image.shape[:2])}, found {tuple(signed_radius.shape)}")
    for name, tensor in (("image", image), ("signed_radius", signed_radius)):
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu" or not tensor.is_contiguous():
            kind = "contiguous" if tensor.is_contiguous() else "strided"
            found = f"{kind} {tensor.dtype} on {tensor.device}"
            raise ValueError(f"{name}: expected contiguous float32 on cpu, found {found}")
    if not alpha > 0:
        raise ValueError(f"alpha: expected a positive number, found {alpha}")
    if energy not in ("area", "algorithm1"):
        raise ValueError(f"energy: expected 'area' or 'algorithm1', found {energy!r}")
    if form not in ("auto", "direct", "linear"):
        raise ValueError(f"form: expected 'auto', 'direct' or 'linear', found {form!r}")


def _is_linear(form: str, largest: float, shape: ApertureShape) -> bool:
    if form == "auto":
        return shape.obstruction == 0 and largest >= LINEAR_FROM
    if form == "linear" and shape.obstruction > 0:
        raise ValueError("form: expected 'auto' or 'direct' for an aperture with a central stop, found 'linear'")
    return form == "linear"


class _Scatter(torch.autograd.Function):
    """Three channels at a time; keeps the packed sources for the way back."""

    @staticmethod
    def forward(context, image, signed_radius, alpha, shape, area, form):
        colours, radii = image.numpy(), signed_radius.numpy()
        largest_radius = float(np.abs(radii).max())
        if not np.isfinite(largest_radius):
            raise FloatingPointError("signed_radius: expected finite values, found NaN or infinity")
        linear = _is_linear(form, largest_radius, shape)
        sizes = geometry(*radii.shape, largest_radius, alpha)
        edge = edges(sizes, largest_radius, alpha, shape)
        packed = pack_sources(colours, radii, sizes, edge.kind == RATIONAL, np.float32(2.0 * alpha),
                              np.float32(edge.base), area, edge.inscribed)
        prefix = prefix_sums(packed[0], sizes.height, PLANES, 1, sizes.stride) if linear else _NO_PREFIX
        blurred, total = cpu_direct.forward(*packed, prefix, sizes, edge)
        context.save_for_backward(image, signed_radius)
        context.kept = (blurred, total, packed, linear, sizes, edge, alpha, area)
        return torch.from_numpy(blurred)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        image, signed_radius = context.saved_tensors
        blurred, total, packed, linear, sizes, edge, alpha, area = context.kept
        by_sums, own = cpu_direct_backward.pack_gradient(
            gradient.contiguous().numpy(), image.numpy(), blurred, total, sizes)
        prefix = prefix_sums(by_sums, sizes.height, SUMS, 0, sizes.stride) if linear else _NO_PREFIX
        by_colour, by_radius = cpu_direct_backward.backward(
            *packed, signed_radius.numpy(), by_sums, own, prefix, sizes, edge, alpha, area)
        return torch.from_numpy(by_colour), torch.from_numpy(by_radius), None, None, None, None
