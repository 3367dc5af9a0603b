"""The scatter on a CPU: float32, numba, two forms with one result (see reference.py for the definition)."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from torch import Tensor

from dofbench.core.lens import ALPHA, ApertureShape, Energy
from dofbench.runtime.backend import Backend
from dofbench.runtime.kernel_cache import is_compiled

from . import cpu_direct, cpu_direct_backward, cpu_linear, cpu_linear_backward
from .cpu_pack import COLOURS, RATIONAL, brightness, edges, geometry, pack_sources
from .reference import check, check_largest

# Largest radius, pixels, from which on "auto" uses the linear form. At 504 x 378 forward and backward pass together
# take equally long in both forms at about 22 px on smooth disparity, and at 17 px on noise, where the direct form can't
# use its cheap exponentials; the forward pass alone at 18 and at 16 px.
LINEAR_FROM = 18.0


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

    float32 on the CPU, contiguous. Differentiable with respect to both, with d|s|/ds = +1 at s = 0. The same
    input gives the same bits, whatever the number of threads. Raises ValueError for other tensors and for unknown
    options, FloatingPointError for a radius that isn't finite; a NaN in the image comes out as NaN.
    """
    check(image, signed_radius, alpha, energy, form, "cpu")
    height, width, channels = image.shape
    groups = []
    for first in range(0, channels, COLOURS):
        colours = image[..., first : first + COLOURS]
        if colours.shape[2] < COLOURS:
            colours = torch.nn.functional.pad(colours, (0, COLOURS - colours.shape[2]))
        groups.append(_Scatter.apply(colours.contiguous(), signed_radius, alpha, shape, energy == "area", form))
    blurred = groups[0] if len(groups) == 1 else torch.cat(groups, dim=2)
    return blurred if blurred.shape[2] == channels else blurred[..., :channels].contiguous()


def _is_linear(form: str, largest: float, shape: ApertureShape) -> bool:
    if form == "auto":
        return shape.is_disc and largest >= LINEAR_FROM
    if form == "linear" and not shape.is_disc:
        raise ValueError("form: expected 'auto' or 'direct' for an aperture that is no full disc, found 'linear'")
    return form == "linear"


class _Scatter(torch.autograd.Function):
    """The scatter of three channels at a time; keeps the packed sources for the backward pass."""

    @staticmethod
    def forward(context, image, signed_radius, alpha, shape, area, form):
        colours, radii = image.numpy(), signed_radius.numpy()
        largest = float(max(-radii.min(), radii.max()))
        check_largest(largest, torch.finfo(torch.float32))
        height, width = radii.shape
        brightest, mean = brightness(colours)
        sizes = geometry(height, width, largest, alpha, brightest, mean, shape.obstruction > 0)
        context.save_for_backward(image, signed_radius)
        context.options = sizes, alpha, area
        if _is_linear(form, largest, shape):
            blurred, total = cpu_linear.forward(colours, radii, sizes, alpha, area)
            context.packed = None
        else:
            edge = edges(sizes, largest, alpha, shape)
            planes, reach = pack_sources(
                colours, radii, sizes, edge.kind == RATIONAL, np.float32(2.0 * alpha), np.float32(edge.base), area
            )
            blurred, total = cpu_direct.forward(planes, reach, sizes, edge)
            context.packed = planes, reach, edge
        context.sums = blurred, total
        return torch.from_numpy(blurred)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        image, radii = (tensor.numpy() for tensor in context.saved_tensors)
        gradient = gradient.contiguous().numpy()
        blurred, total = context.sums
        sizes, alpha, area = context.options
        if context.packed is None:
            by_colour, by_radius = cpu_linear_backward.backward(
                gradient, image, radii, blurred, total, sizes, alpha, area
            )
        else:
            sources, reach, edge = context.packed
            by_sums, own = cpu_direct_backward.pack_gradient(gradient, image, blurred, total, sizes)
            by_colour, by_radius = cpu_direct_backward.backward(
                sources, reach, radii, by_sums, own, sizes, edge, alpha, area
            )
        return torch.from_numpy(by_colour), torch.from_numpy(by_radius), None, None, None, None


def _warm_up(**options) -> None:
    """Compile the direct form. The linear form is compiled when a radius first needs it, or with form="linear"."""
    image = torch.rand((32, 32, COLOURS), generator=torch.Generator().manual_seed(0)).requires_grad_()
    scatter(image, torch.ones((32, 32)).requires_grad_(), **options).sum().backward()


BACKEND = Backend(
    devices=("cpu",),
    dtypes=("float32",),
    bits_repeat=True,
    warm_up=_warm_up,
    is_warm=lambda: is_compiled(cpu_direct_backward._finish),
)
