"""Compiling on two cores: a second process compiles the lens and the loss while this one does the rasteriser.

Numba compiles behind one lock, so only processes run side by side; the cache on disk is how one's work reaches
the other. On a machine that has compiled before nothing is started.
"""

from __future__ import annotations

import contextlib
import gc
import subprocess
import sys
from collections.abc import Iterable

import torch

from dofbench.compute.raster import GEOMETRIES, Geometry, ViewStatistics
from dofbench.core.cameras import Camera
from dofbench.gaussians.gaussian_options import GaussianOptions
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.render import rasterise
from dofbench.kernels import is_warm, warm_up

_PATIENCE = 300.0  # seconds for the other process; after that this one compiles for itself


def compile_kernels(gaussians: Gaussians, camera: Camera, options: GaussianOptions, later: Iterable[Geometry]) -> None:
    """Have the kernels of all training steps compiled, where no earlier process has done it; changes no argument.

    later: what steps rasterise beside depth, which would otherwise be compiled in the middle of training, on its clock.
    """
    if not is_warm("rasterize"):
        _compile_side_by_side(gaussians, camera, options)
    for geometry in sorted(set(later) - {"depth"}, key=GEOMETRIES.index):
        _rasterise_once(gaussians, camera, options, geometry)


def _rasterise_once(gaussians: Gaussians, camera: Camera, options: GaussianOptions, geometry: Geometry) -> None:
    statistics = ViewStatistics(want_abs=options.density.grow_absolute)
    # Numbers that aren't finite are training's to report.
    with contextlib.suppress(FloatingPointError):
        raster = rasterise(gaussians, camera, options.appearance, geometry=geometry, statistics=statistics)
        total = torch.stack([output.sum() for output in raster if output is not None]).sum()
        torch.autograd.grad(total, list(gaussians.parameters.values()), allow_unused=True)


def _compile_side_by_side(gaussians: Gaussians, camera: Camera, options: GaussianOptions) -> None:
    others = ("ssim", *(("scatter", "tone") if options.lens.lens else ()))
    command = [sys.executable, "-P", "-m", "dofbench.gaussians.warmup", *others]
    # A tenth of compiling is the garbage collector, which finds nothing.
    collecting = gc.isenabled()
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as other:
        try:
            gc.disable()
            _rasterise_once(gaussians, camera, options, "depth")
            other.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            pass  # training compiles for itself what is missing
        finally:
            other.kill()
            if collecting:
                gc.enable()


if __name__ == "__main__":
    gc.disable()
    for op in sys.argv[1:]:
        warm_up(op)
