"""JIT compilation before training: the kernels of rasteriser, lens, loss and depth prior."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Sequence

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.runtime.compilation import compile_all
from dofbench.runtime.raster import GEOMETRIES, Geometry, ViewStatistics
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import rasterise, rasterise_from_points


def compile_kernels(
    gaussians: Gaussians,
    camera: Camera,
    options: GaussianOptions,
    later: Collection[Geometry],
    samples_aperture: bool,
    more: Sequence[str] = (),
) -> None:
    """Compile the kernels of all training steps, so that no compilation falls into the measured time.

    later: geometries other than "depth" that steps rasterise. samples_aperture: whether steps rasterise from aperture
    samples. more: further ops of the steps.
    """
    device = gaussians.parameters["means"].device.type
    called = (
        "rasterize",
        *(("stereo",) if options.prior.matches_views else ()),
        "ssim",
        "surface",
        *(("colours",) if options.colours.colour_per_view == "affine" else ()),
        *more,
        *(("tone", "scatter") if options.lens.lens else ()),
    )
    compile_all(called, device)
    for geometry in GEOMETRIES:
        if geometry != "depth" and geometry in later:
            _rasterise_once(gaussians, camera, options, geometry)
    if samples_aperture:
        _rasterise_from_points(gaussians, camera, options)


def _rasterise_from_points(gaussians: Gaussians, camera: Camera, options: GaussianOptions) -> None:
    statistics = ViewStatistics(want_abs=options.density.grow_absolute)
    closed = torch.zeros_like(gaussians.parameters["opacity_logits"], requires_grad=True)
    with contextlib.suppress(FloatingPointError):
        images = rasterise_from_points(
            gaussians, camera, options.appearance, np.zeros((1, 2)), closed, closed, statistics=statistics
        )
        torch.autograd.grad(images.sum(), [closed, *gaussians.parameters.values()], allow_unused=True)


def _rasterise_once(gaussians: Gaussians, camera: Camera, options: GaussianOptions, geometry: Geometry) -> None:
    statistics = ViewStatistics(want_abs=options.density.grow_absolute)
    # Values that aren't finite are reported by training itself.
    with contextlib.suppress(FloatingPointError):
        raster = rasterise(gaussians, camera, options.appearance, geometry=geometry, statistics=statistics)
        total = torch.stack([output.sum() for output in raster if output is not None]).sum()
        torch.autograd.grad(total, list(gaussians.parameters.values()), allow_unused=True)
