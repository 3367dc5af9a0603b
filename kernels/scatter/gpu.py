"""The scatter on a GPU: float32, Triton, the direct form."""

from __future__ import annotations

import math
from functools import cache
from typing import Literal

import torch
from torch import Tensor

from dofbench.compute.backend import Backend
from dofbench.compute.gpu_launch import kernels, kernels_device, launch
from dofbench.core.lens import ALPHA, ApertureShape, Energy

from .reference import STOP_OPACITY, check

BACKEND = Backend(devices=("cuda",), dtypes=("float32",), bits_repeat=True)
_COLOURS = 3
_TILE = {"TILE_Y": 8, "TILE_X": 32}
_BLOCK = 512
# Of the largest image values a highlight is told by this multiple of the mean, as on the CPU (cpu_pack.py).
_BRIGHT = math.e * 4.0
_LARGEST_RADIUS = torch.finfo(torch.float32).tiny ** -0.5


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

    float32 on a GPU. Differentiable with respect to both, with d|s|/ds = +1 at s = 0. The same input gives the same
    bits. Both forms have one result, and here only the direct one exists, so `form` is ignored. A radius that isn't
    finite, or above 9e18, makes the pixels that it reaches NaN instead of raising, since raising would have the host
    wait for the device. Raises ValueError for other tensors and for unknown options.
    """
    check(image, signed_radius, alpha, energy, form, kernels_device())
    channels = image.shape[2]
    groups = []
    for first in range(0, channels, _COLOURS):
        colours = image[..., first : first + _COLOURS]
        if colours.shape[2] < _COLOURS:
            colours = torch.nn.functional.pad(colours, (0, _COLOURS - colours.shape[2]))
        groups.append(_Scatter.apply(colours.contiguous(), signed_radius, alpha, shape, energy == "area"))
    blurred = groups[0] if len(groups) == 1 else torch.cat(groups, dim=2)
    return blurred if blurred.shape[2] == channels else blurred[..., :channels].contiguous()


@cache
def _normals(shape: ApertureShape, device: torch.device) -> Tensor:
    """(blades, 2): unit normals of the polygon's edges, x to the right, y down. Kept, since each is a copy to the
    device."""
    middles = shape.rotation + (2 * torch.arange(shape.blades, dtype=torch.float64) + 1) * (math.pi / shape.blades)
    return torch.stack([middles.cos(), middles.sin()], 1).float().to(device)


def _brightness(image: Tensor, radius: Tensor) -> Tensor:
    """(3,) on the device: largest magnitude of the image, mean of those that are no highlights, largest radius.

    Largest and mean are 1 where they can't be computed: NaN and infinity appear in the result anyway.
    """
    magnitude = image.abs()
    largest, mean = magnitude.amax(), magnitude.mean()
    usual = magnitude <= _BRIGHT * mean
    without = (magnitude * usual).sum() / usual.sum().clamp(min=1)
    mean = torch.where(largest <= _BRIGHT * mean, mean, without)
    known = largest.isfinite() & mean.isfinite()
    both = torch.where(known, torch.stack([largest, mean]), 1.0)
    return torch.cat([both, radius.abs().amax()[None]])


class _Scatter(torch.autograd.Function):
    """The scatter of three channels at a time."""

    @staticmethod
    def forward(context, image, signed_radius, alpha, shape, area):
        direct = kernels("scatter.gpu_direct")
        height, width = signed_radius.shape
        size = height * width
        shaped = not (shape.blades == 0 or shape.curvature == 1)
        normals = _normals(shape, image.device) if shaped else image
        # An aperture that is no polygon never looks at its blades.
        aperture = normals, shape.blades, math.cos(math.pi / shape.blades) if shaped else 1.0, float(shape.curvature)
        kind = {"SHAPED": shaped, "STOPPED": shape.obstruction > 0}
        planes = torch.empty(5, height, width, device=image.device)
        blocks = (-(-size // _BLOCK),)
        launch(
            direct.pack_sources, blocks, image, signed_radius, planes, size, _LARGEST_RADIUS, AREA=area, BLOCK=_BLOCK
        )
        tiles = -(-height // _TILE["TILE_Y"]), -(-width // _TILE["TILE_X"])
        reach = torch.empty(tiles, device=image.device)
        window = torch.empty(tiles, dtype=torch.int32, device=image.device)
        stop = -math.log(1.0 - STOP_OPACITY) if shape.obstruction > 0 else 0.0
        bright = _brightness(image, signed_radius)
        launch(
            direct.tile_reach, tiles, image, signed_radius, bright, reach, height, width, float(alpha), stop, **_TILE
        )
        launch(direct.tile_window, (tiles[0] * tiles[1],), reach, window, *tiles, BLOCK=_BLOCK, **_TILE)
        blurred, total = torch.empty_like(image), torch.empty_like(signed_radius)
        options = float(alpha), *aperture, float(shape.obstruction)
        launch(direct.gather, tiles, planes, window, blurred, total, height, width, *options, **kind, **_TILE)
        context.save_for_backward(image, signed_radius, blurred, total, reach, normals)
        context.options, context.kind = options, kind | {"AREA": area}
        return blurred

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        direct = kernels("scatter.gpu_direct")
        image, signed_radius, blurred, total, reach, _ = context.saved_tensors
        height, width = signed_radius.shape
        size = height * width
        targets = torch.empty(4, height, width, device=image.device)
        blocks = (-(-size // _BLOCK),)
        launch(direct.pack_targets, blocks, gradient.contiguous(), blurred, total, targets, size, BLOCK=_BLOCK)
        by_image, by_radius = torch.empty_like(image), torch.empty_like(signed_radius)
        launch(
            direct.gather_gradient,
            tuple(reach.shape),
            targets,
            reach,
            image,
            signed_radius,
            by_image,
            by_radius,
            height,
            width,
            *context.options,
            **context.kind,
            **_TILE,
        )
        return by_image, by_radius, None, None, None
