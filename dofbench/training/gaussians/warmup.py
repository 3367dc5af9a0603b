"""JIT compilation on two cores: a second process compiles the kernels of lens and loss, this one the rasteriser.

Numba holds one lock while it compiles, so threads wouldn't help. The code comes back through the cache on disk; if it
is there already, no process is started.
"""

from __future__ import annotations

import contextlib
import gc
import subprocess
import sys
from collections.abc import Collection, Sequence

import numpy as np
import torch

from dofbench.core.cameras import Camera
from dofbench.runtime.ops import is_warm, warm_up
from dofbench.runtime.raster import GEOMETRIES, Geometry, ViewStatistics
from dofbench.training.gaussians.gaussian_options import GaussianOptions
from dofbench.training.gaussians.model import Gaussians
from dofbench.training.gaussians.render import rasterise, rasterise_from_points

_PATIENCE = 300.0  # seconds to wait for the other process; after that this process compiles all kernels itself


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
    affine = options.colours.colour_per_view == "affine"
    called = (
        "ssim",
        "surface",
        *(("scatter", "tone") if options.lens.lens else ()),
        *(("colours",) if affine else ()),
        *more,
    )
    others = [op for op in called if not is_warm(op, device)]
    if device == "cpu" and not is_warm("rasterize"):
        _compile_side_by_side(gaussians, camera, options, others)
    else:
        for op in others:
            warm_up(op, device)
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


def _compile_side_by_side(
    gaussians: Gaussians, camera: Camera, options: GaussianOptions, others: Sequence[str]
) -> None:
    command = [sys.executable, "-P", "-m", "dofbench.training.gaussians.warmup", *others]
    # The garbage collector would take a tenth of the compile time, for nothing.
    collecting = gc.isenabled()
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as other:
        try:
            gc.disable()
            _rasterise_once(gaussians, camera, options, "depth")
            other.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            pass  # training itself compiles whatever is missing
        finally:
            other.kill()
            if collecting:
                gc.enable()


if __name__ == "__main__":
    gc.disable()
    for op in sys.argv[1:]:
        warm_up(op)
