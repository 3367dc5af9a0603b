"""One call of each op as training makes it, for `measure.py`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.core.cameras import Camera
from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.ops import load
from dofbench.training.common.depth import SURFACE_ALPHA
from dofbench.training.common.priors.stereo import BEST, EDGE, LARGE, RADIUS, SMALL, SOURCES
from dofbench.training.gaussians.lens_pattern import lens_points

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")


@dataclass(frozen=True)
class Size:
    """Size of the calls: image and CoC radius in pixels, number of Gaussians; nodes a side of a field, its rays and
    samples a ray; depth planes of stereo."""

    width: int = 504
    height: int = 378
    gaussians: int = 150_000
    radius: float = 8.0
    nodes: int = 200
    rays: int = 1024
    samples: int = 60
    planes: int = 128


@dataclass(frozen=True)
class Call:
    """A call of an op. inputs: tensors on the CPU. run: takes them on any device, returns the outputs. learns: whether
    the inputs have gradients."""

    inputs: tuple[Tensor, ...]
    run: Callable[..., list[Tensor]]
    learns: bool = True

    def on(self, device: str) -> tuple[Tensor, ...]:
        """The inputs on a device."""
        return tuple(value.detach().to(device).requires_grad_(self.learns) for value in self.inputs)


def random_scene(n: int, width: int, height: int, pixels: float, seed: int = 0) -> tuple[list[torch.Tensor], Camera]:
    """Random Gaussians, `pixels` wide on average, spread over the image and a little beyond."""
    generator = torch.Generator().manual_seed(seed)
    focal = 1.1 * width
    u, v = (torch.rand(n, generator=generator) * 1.1 - 0.55 for _ in range(2))
    z = 2 + 6 * torch.rand(n, generator=generator)
    scales = torch.log(pixels * z / focal)[:, None] + 0.5 * torch.randn(n, 3, generator=generator)
    parameters = [
        torch.stack([u * width / focal * z, v * height / focal * z, z], 1),
        scales,
        torch.randn(n, 4, generator=generator),
        torch.randn(n, generator=generator) * 1.5 - 0.5,
        torch.randn(n, 3, generator=generator) * 0.5,
        torch.randn(n, 15, 3, generator=generator) * 0.1,
    ]
    return parameters, Camera(width, height, focal, focal, width / 2, height / 2, np.eye(4))


def gaussians(size: Size) -> tuple[list[Tensor], Camera]:
    """Random Gaussians over an image and a little beyond, three to a pixel's area on average, as in trained scenes."""
    pixels = 1.7 * (size.width * size.height / size.gaussians) ** 0.5
    return random_scene(size.gaussians, size.width, size.height, pixels)


def _pictures(size: Size, count: int = 1) -> list[Tensor]:
    random = torch.Generator().manual_seed(1)
    return [torch.rand(size.height, size.width, 3, generator=random) for _ in range(count)]


def tone(size: Size) -> Call:
    """Decode an image."""
    return Call(tuple(_pictures(size)), lambda image: [load("tone")(image, 2.2, 0.002, 0.002**1.2)])


def ssim(size: Size) -> Call:
    """The colour loss of the presets."""
    image, target = _pictures(size, 2)
    loss = load("ssim", function="l1_ssim")
    return Call((image,), lambda image: [loss(image, target.to(image.device), ssim_weight=0.4, edge_weight=4.0)])


def scatter(size: Size) -> Call:
    """Scatter a ramp of CoC radii from one side to the other."""
    ramp = torch.linspace(-size.radius, size.radius, size.width).repeat(size.height, 1)
    return Call((*_pictures(size), ramp), lambda image, radius: [load("scatter")(image, radius)])


def surface(size: Size) -> Call:
    """CoC radii of a slanted surface with holes."""
    depth = torch.linspace(1.0, 4.0, size.width).repeat(size.height, 1)
    random = torch.Generator().manual_seed(5)
    alpha = torch.rand(size.height, size.width, generator=random)

    def run(depth: Tensor, slope: Tensor, offset: Tensor) -> list[Tensor]:
        disparity = load("surface")(depth, alpha.to(depth.device), SURFACE_ALPHA)
        radius = load("surface", function="circle")(disparity, slope, offset, low=0.3, extent=0.6, scale=size.radius)
        return [disparity, radius]

    return Call((depth, torch.tensor(0.7), torch.tensor(-0.4)), run)


def known_depth(size: Size) -> Call:
    """The error of a depth that is known in every pixel, in disparity."""
    random = torch.Generator().manual_seed(6)
    count = size.width * size.height
    pixels = torch.arange(count, dtype=torch.int32)
    known, shares = 1 + torch.rand(count, generator=random), torch.rand(count, generator=random)
    samples = pixels // size.width, pixels % size.width, known, shares
    error = load("surface", function="known_depth")

    def run(depth: Tensor) -> list[Tensor]:
        given = (value.to(depth.device) for value in samples)
        alpha = torch.ones_like(depth)
        return [error(depth, alpha, *given, None, most=1, least_alpha=SURFACE_ALPHA, extent=0.5, squared=False)]

    return Call((1 + torch.rand(size.height, size.width, generator=random),), run)


def colours(size: Size) -> Call:
    """An affine map of an image's colours."""
    change = torch.rand(3, 4, generator=torch.Generator().manual_seed(7))
    return Call((*_pictures(size), change), lambda image, matrix: [load("colours")(image, matrix)])


def mix(size: Size) -> Call:
    """Blur kernels of 9 × 9 pixels."""
    logits = torch.randn(size.height, size.width, 81, generator=torch.Generator().manual_seed(2))
    return Call((*_pictures(size), logits), lambda image, weights: [load("mix")(image, weights)])


def rasterize(size: Size) -> Call:
    """Colour, opacity and depth of one image."""
    parameters, camera = gaussians(size)

    def run(*inputs: Tensor) -> list[Tensor]:
        raster = load("rasterize")(**dict(zip(NAMES, inputs, strict=True)), camera=camera)
        return [raster.color, raster.alpha, raster.depth]

    return Call(tuple(parameters), run)


def rasterize_from_points(size: Size) -> Call:
    """An image from each of five aperture samples."""
    parameters, camera = gaussians(size)
    random = torch.Generator().manual_seed(3)
    radius = size.radius * (2 * torch.rand(size.gaussians, generator=random) - 1)
    blur = 0.08 * radius.square()

    def run(*inputs: Tensor) -> list[Tensor]:
        named: dict[str, Any] = dict(zip((*NAMES, "radius", "blur"), inputs, strict=True))
        kernel = load("rasterize", function="rasterize_from_points")
        return [kernel(**named, camera=camera, points=lens_points(1))]

    return Call((*parameters, radius, blur), run)


@dataclass(frozen=True)
class FieldRays:
    """Rays through a cube, from one side to the other.

    learned: tensors of the grid. origins, directions: (R, 3) in the cube. places: (S,) of each ray's samples. length:
    of a sample.
    """

    shape: GridShape
    learned: tuple[Tensor, Tensor, Tensor]
    origins: Tensor
    directions: Tensor
    places: Tensor
    length: float

    def density(self, points: Tensor) -> Tensor:
        """(P,) at points (P, 3)."""
        found: Tensor = load("field", function="field_density")(self.learned[0], points, shape=self.shape, shift=0.0)
        return found


def field_rays(size: Size) -> FieldRays:
    """The rays of the call of `field`."""
    shape, random = GridShape((size.nodes,) * 3, 8, 16, 9), torch.Generator().manual_seed(4)

    def drawn(*sizes: int) -> Tensor:
        return torch.rand(*sizes, generator=random)

    density, colour = (2 * drawn(count) - 1 for count in (shape.density_size, shape.colour_size))
    learned = density, colour, drawn(*shape.basis_shape)
    origins = torch.cat([drawn(size.rays, 2), torch.zeros(size.rays, 1)], 1)
    directions = torch.cat([0.2 * drawn(size.rays, 2) - 0.1, torch.ones(size.rays, 1)], 1)
    places = (torch.arange(size.samples) + 0.5) / size.samples
    return FieldRays(shape, learned, origins, directions, places, 1.0 / size.samples)


def field(size: Size) -> Call:
    """Render rays with gradients of their own, as a lens needs."""
    rays = field_rays(size)
    count = size.rays * size.samples
    rest = {
        "views": torch.nn.functional.normalize(rays.directions, dim=1),
        "starts": torch.arange(0, count + 1, size.samples),
        "places": rays.places.repeat(size.rays),
        "lengths": torch.full((count,), rays.length),
    }

    def run(*inputs: Tensor) -> list[Tensor]:
        others = {name: value.to(inputs[0].device) for name, value in rest.items()}
        found = load("field")(*inputs, **others, shape=rays.shape, shift=0.0)
        return [found.color, found.opacity, found.distance]

    return Call((*rays.learned, rays.origins, rays.directions), run)


def stereo(size: Size) -> Call:
    """A plane sweep over four shifted views, and semi-global paths through its scores."""
    grey = [image.mean(2) for image in _pictures(size, SOURCES + 1)]
    maps = torch.eye(3, 4, dtype=torch.float64).repeat(SOURCES, 1, 1)
    maps[:, 0, 3] = 10 * torch.arange(1, SOURCES + 1, dtype=torch.float64)
    planes = torch.linspace(0.1, 1.0, size.planes, dtype=torch.float64)

    def run(image: Tensor, others: Tensor) -> list[Tensor]:
        given = (value.to(image.device) for value in (maps, planes))
        scores = load("stereo")(image, others, *given, radius=RADIUS, best=BEST)
        found = load("stereo", function="semiglobal")(scores, image, small=SMALL, large=LARGE, edge=EDGE)
        return [scores, *found]

    return Call((grey[0], torch.stack(grey[1:])), run, learns=False)


CALLS: dict[str, Callable[[Size], Call]] = {
    one.__name__: one
    for one in (
        tone,
        ssim,
        scatter,
        surface,
        known_depth,
        colours,
        mix,
        rasterize,
        rasterize_from_points,
        field,
        stereo,
    )
}


def gradients(call: Call, inputs: tuple[Tensor, ...]) -> tuple[list[Tensor], list[Tensor]]:
    """(results, gradients of the inputs by the sum of the results' squares, none where they have none)."""
    found = call.run(*inputs)
    if not call.learns:
        return found, []
    total = torch.stack([value.square().sum() for value in found]).sum()
    return found, list(torch.autograd.grad(total, inputs))
