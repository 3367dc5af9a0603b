"""One call of each op as training makes it, for `gpu_measure.py`: its tensors, and what is called with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.gaussians.forward.lens_pattern import lens_points
from dofbench.kernels import load

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")


@dataclass(frozen=True)
class Size:
    """Of a picture, pixels, of its circles of confusion, pixels, and how many Gaussians it shows."""

    width: int = 504
    height: int = 378
    gaussians: int = 150_000
    radius: float = 8.0


@dataclass(frozen=True)
class Call:
    """inputs: tensors that have gradients, on the CPU. run: called with them, on any device; its results, each of which
    has a gradient."""

    inputs: tuple[Tensor, ...]
    run: Callable[..., list[Tensor]]

    def on(self, device: str) -> tuple[Tensor, ...]:
        """The inputs on a device."""
        return tuple(value.detach().to(device).requires_grad_() for value in self.inputs)


def gaussians(size: Size) -> tuple[tuple[Tensor, ...], Camera]:
    """Random Gaussians over a picture and a little beyond, each as wide as what it covers: three of them to a pixel's
    area on average, as in trained scenes."""
    random = torch.Generator().manual_seed(0)
    count, focal = size.gaussians, 1.1 * size.width
    u, v = (torch.rand(count, generator=random) * 1.1 - 0.55 for _ in range(2))
    z = 2 + 6 * torch.rand(count, generator=random)
    pixels = 1.7 * (size.width * size.height / count) ** 0.5
    parameters = (
        torch.stack([u * size.width / focal * z, v * size.height / focal * z, z], 1),
        torch.log(pixels * z / focal)[:, None] + 0.5 * torch.randn(count, 3, generator=random),
        torch.randn(count, 4, generator=random),
        torch.randn(count, generator=random) * 1.5 - 0.5,
        torch.randn(count, 3, generator=random) * 0.5,
        torch.randn(count, 15, 3, generator=random) * 0.1,
    )
    return parameters, Camera(size.width, size.height, focal, focal, size.width / 2, size.height / 2, np.eye(4))


def _pictures(size: Size, count: int = 1) -> list[Tensor]:
    random = torch.Generator().manual_seed(1)
    return [torch.rand(size.height, size.width, 3, generator=random) for _ in range(count)]


def tone(size: Size) -> Call:
    """Decoding a picture."""
    return Call(tuple(_pictures(size)), lambda image: [load("tone")(image, 2.2, 0.002, 0.002**1.2)])


def ssim(size: Size) -> Call:
    """The colour loss of the presets."""
    image, target = _pictures(size, 2)
    loss = load("ssim", function="l1_ssim")
    return Call((image,), lambda image: [loss(image, target.to(image.device), ssim_weight=0.4, edge_weight=4.0)])


def scatter(size: Size) -> Call:
    """A ramp of circles of confusion from one side to the other."""
    ramp = torch.linspace(-size.radius, size.radius, size.width).repeat(size.height, 1)
    return Call((*_pictures(size), ramp), lambda image, radius: [load("scatter")(image, radius)])


def mix(size: Size) -> Call:
    """Kernels of 9 x 9 pixels."""
    logits = torch.randn(size.height, size.width, 81, generator=torch.Generator().manual_seed(2))
    return Call((*_pictures(size), logits), lambda image, weights: [load("mix")(image, weights)])


def rasterize(size: Size) -> Call:
    """Colour, opacity and depth of one picture."""
    parameters, camera = gaussians(size)

    def run(*inputs: Tensor) -> list[Tensor]:
        raster = load("rasterize")(**dict(zip(NAMES, inputs, strict=True)), camera=camera)
        return [raster.color, raster.alpha, raster.depth]

    return Call(parameters, run)


def rasterize_from_points(size: Size) -> Call:
    """A picture from each of five points of the lens."""
    parameters, camera = gaussians(size)
    random = torch.Generator().manual_seed(3)
    radius = size.radius * (2 * torch.rand(size.gaussians, generator=random) - 1)
    blur = 0.08 * radius.square()

    def run(*inputs: Tensor) -> list[Tensor]:
        named: dict[str, Any] = dict(zip((*NAMES, "radius", "blur"), inputs, strict=True))
        kernel = load("rasterize", function="rasterize_from_points")
        return [kernel(**named, camera=camera, points=lens_points(1))]

    return Call((*parameters, radius, blur), run)


CALLS: dict[str, Callable[[Size], Call]] = {
    one.__name__: one for one in (tone, ssim, scatter, mix, rasterize, rasterize_from_points)
}


def gradients(call: Call, inputs: tuple[Tensor, ...]) -> tuple[list[Tensor], list[Tensor]]:
    """(results, gradients of the inputs by the sum of the results' squares)."""
    found = call.run(*inputs)
    total = torch.stack([value.square().sum() for value in found]).sum()
    return found, list(torch.autograd.grad(total, inputs))
