"""The scatter on a CPU: float32, numba, two forms with one result (see op.py)."""

from __future__ import annotations

import numpy as np
import torch

from dofbench.core.lens import ApertureShape
from dofbench.runtime.kernel_cache import cpu_backend

from . import cpu_direct, cpu_direct_backward, cpu_linear, cpu_linear_backward, op
from .cpu_pack import RATIONAL, brightness, edges, geometry, pack_sources
from .op import COLOURS, check_largest, in_threes, joined

# Largest radius, pixels, from which on "auto" uses the linear form. At 504 x 378 forward and backward pass together
# take equally long in both forms at about 22 px on smooth disparity, and at 17 px on noise, where the direct form can't
# use its cheap exponentials; the forward pass alone at 18 and at 16 px.
LINEAR_FROM = 18.0


def scatter(image, signed_radius, alpha, shape, area, form):
    groups = [_Scatter.apply(colours, signed_radius, alpha, shape, area, form) for colours in in_threes(image)]
    return joined(groups, image.shape[2])


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
    op.scatter(image, torch.ones((32, 32)).requires_grad_(), **options).sum().backward()


BACKEND = cpu_backend(_warm_up, cpu_direct_backward._finish)
