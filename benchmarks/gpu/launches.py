"""The launches of Triton kernels that training makes, by small calls of every GPU backend through the interpreter.

    TRITON_INTERPRET=1 python -m benchmarks.gpu.launches

Prints one line of JSON for each launch: where the kernel is, the types of its arguments, its constants, its warps.
What is compiled depends on types and constants alone, not on sizes, so pictures are tiny. `kernels.py` compiles
them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from itertools import product
from typing import Any

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.core.lens import ApertureShape
from dofbench.runtime.factored_grid import GridShape
from dofbench.runtime.gpu_launch import recorded
from dofbench.runtime.ops import load
from dofbench.runtime.raster import GEOMETRIES, ViewStatistics
from dofbench.training.common.priors.stereo import BEST, PLANES, RADIUS, TOGETHER


def tone() -> None:
    """Decoding and encoding differ in numbers alone."""
    load("tone", "gpu")(torch.rand(9).requires_grad_(), 2.2, 0.002, 0.002**1.2).sum().backward()


def ssim() -> None:
    """The colour loss of the presets: with and without a weight, and with edges."""
    loss = load("ssim", "gpu", function="l1_ssim")
    weight = torch.rand(3, 4)
    for options in ({}, {"edge_weight": 4.0}, {"weight": weight}, {"weight": weight, "weigh_all": True}):
        loss(torch.rand(3, 4, 3).requires_grad_(), torch.rand(3, 4, 3), ssim_weight=0.4, **options).backward()


def scatter() -> None:
    """Discs, polygons, and polygons and discs with a stop, with the area term and without; both forms."""
    shapes = ApertureShape(), ApertureShape(blades=6), ApertureShape(blades=6, obstruction=0.3)
    for shape, energy in (*((shape, "area") for shape in shapes), (ApertureShape(), "algorithm1")):
        image, radius = torch.rand(1, 2, 3).requires_grad_(), torch.zeros(1, 2).requires_grad_()
        load("scatter", "gpu")(image, radius, shape=shape, energy=energy).sum().backward()


def mix() -> None:
    """Kernels of BAGS' three scales."""
    for size in (5, 9, 17):
        image, logits = torch.rand(1, 2, 3).requires_grad_(), torch.rand(1, 2, size * size).requires_grad_()
        load("mix", "gpu")(image, logits).sum().backward()


def rasterize() -> None:
    """Every level of geometry, harmonics of every degree, with density control's statistics and without; 3DGS's
    dilation; Gaussians blurred each by itself; points of a lens."""
    camera = Camera(4, 4, 4.0, 4.0, 2.0, 2.0, np.eye(4))
    one = torch.ones(1)

    def call(function: str, rest: int = 15, **options: Any) -> None:
        shapes = (1, 3), (1, 3), (1, 4), (1,), (1, 3), (1, rest, 3)
        parameters = [torch.zeros(shape) for shape in shapes]
        parameters[0][:, 2] = 4.0
        drawn = load("rasterize", "gpu", function=function)(
            *(parameter.requires_grad_() for parameter in parameters), camera=camera, **options
        )
        outputs = [drawn] if isinstance(drawn, torch.Tensor) else [image for image in drawn if image is not None]
        torch.stack([image.sum() for image in outputs]).sum().backward()

    for geometry in GEOMETRIES:
        for statistics in (None, ViewStatistics(), ViewStatistics(want_abs=True)):
            call("rasterize", geometry=geometry, filter_3d=0.1 * one, statistics=statistics)
    for degree in range(4):
        call("rasterize", rest=(degree + 1) ** 2 - 1, filter_3d=0.1 * one)
    call("rasterize", filter_2d_fades=False, filter_2d=0.3)
    call("rasterize", filter_3d=0.1 * one, blur=one.clone().requires_grad_(), statistics=ViewStatistics(want_abs=True))
    lens = {"points": np.zeros((2, 2)), "radius": one.clone().requires_grad_(), "blur": one.clone().requires_grad_()}
    for statistics in (None, ViewStatistics(want_abs=True)):
        call("rasterize_from_points", filter_3d=0.1 * one, statistics=statistics, **lens)


def stereo() -> None:
    """The depth prior's sweep, of a view with one other and with more, and every number of planes that it may have."""
    image = torch.rand(1, 1)
    for best in (1, BEST):
        maps = torch.eye(3, 4, dtype=torch.float64).repeat(best, 1, 1)
        planes = torch.ones(1, dtype=torch.float64)
        load("stereo", "gpu")(image, torch.rand(best, 1, 1), maps, planes, radius=RADIUS, best=best)
    for count in range(PLANES[0], PLANES[1] + 1, TOGETHER):
        scores = torch.rand(1, 1, count)
        load("stereo", "gpu", function="upsample")(scores, torch.rand(1, 1, 9), 0.5)
        load("stereo", "gpu", function="semiglobal")(scores, image, small=0.1, large=0.5, edge=0.1)
    load("stereo", "gpu", function="returns")(image, image, maps[0], maps[0], pixels=1.0, share=0.1)


def field() -> None:
    """The presets' ranks of a field and TensoRF's, harmonics of every degree; rays that learn and rays that don't, and
    with them a single sample in the grid or many."""
    for ranks, terms in (((8, 16), 9), ((8, 16), 4), ((8, 16), 1), ((16, 48), 9), ((24, 24), 9)):
        shape = GridShape((2, 2, 2), *ranks, terms)
        sizes = ((shape.density_size,), (shape.colour_size,), shape.basis_shape)
        ray, ends = torch.full((1, 3), 0.5), torch.tensor([[0.0, 1.0]])
        cells = torch.ones((1, 1, 1), dtype=torch.bool)
        load("field", "gpu", function="field_density")(torch.rand(sizes[0]), ray, shape=shape, shift=0.0)
        for learned, count in ((False, 1), (True, 40)):
            samples = load("field", "gpu", function="field_samples")(ray, ray, ends, torch.zeros(1), cells, count=count)
            grids = [torch.rand(size).requires_grad_() for size in sizes]
            rays = [ray.clone().requires_grad_(learned) for _ in range(3)]
            seen = load("field", "gpu")(
                *grids, *rays, samples.starts, samples.places, samples.steps, shape=shape, shift=0.0
            )
            (seen.color.sum() + seen.opacity.sum()).backward()
            load("field", "gpu", function="field_features")(*grids[:2], ray, shape=shape).sum().backward()


def adam() -> None:
    """Of Gaussians, whose training watches whether values are finite, and of a table of lenses, of colours or of
    focuses, whose gradient counts as 0 where it isn't."""
    values = [[torch.zeros(3)] for _ in range(4)]
    for options in ({"found_inf": torch.zeros(())}, {"finite": True}):
        load("adam", "gpu")(*values, steps=[1], lrs=[0.1], eps=1e-15, **options)


def surface() -> None:
    """Both errors of depth, in disparity and in scene units, with shares and weight and without."""
    depth, alpha, at = torch.ones(3, 4).requires_grad_(), torch.ones(3, 4), torch.zeros(5, dtype=torch.int64)
    slope, known, weight = torch.ones(()).requires_grad_(), torch.rand(5), torch.rand(3, 4)
    disparity = load("surface", "gpu")(depth, alpha, 0.1)
    radius = load("surface", "gpu", function="circle")(disparity, slope, slope, low=0.3, extent=0.7, scale=5.0)
    radius.sum().backward()
    error = load("surface", "gpu", function="known_depth")
    for shares, weights, extent, squared in product((None, known), (None, weight), (None, 0.7), (False, True)):
        options = {"most": 5, "least_alpha": 0.1, "extent": extent, "squared": squared}
        error(depth, alpha, at, at, known, shares, weights, **options).backward()


def colours() -> None:
    """An affine map of a picture's colours."""
    image, change = torch.rand(3, 4, 3).requires_grad_(), torch.zeros(3, 4).requires_grad_()
    load("colours", "gpu")(image, change).sum().backward()


CALLS: tuple[Callable[[], None], ...] = (
    adam, colours, tone, ssim, scatter, surface, mix, rasterize, stereo, field,
)  # fmt: skip


def main() -> None:
    """Print the launches of all calls, each once."""
    with recorded() as launches:
        for call in CALLS:
            call()
    for launch in launches:
        print(json.dumps(asdict(launch)))


if __name__ == "__main__":
    main()
