"""Compiling on two cores: a second process compiles the lens and the loss while this one does the rasteriser.

Numba compiles behind one lock, so only processes run side by side; the cache on disk is how one's work reaches
the other. On a machine that has compiled before nothing is started.
"""

from __future__ import annotations

import contextlib
import gc
import subprocess
import sys
from importlib import import_module

import torch

from dofbench.compute.kernel_cache import is_compiled
from dofbench.compute.raster import Geometry, ViewStatistics
from dofbench.core.cameras import Camera
from dofbench.gaussians import losses
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.render import rasterise
from dofbench.gaussians.trials import questions
from dofbench.learning.options import TrainerOptions
from dofbench.optics.defocus import defocus

_PATIENCE = 300.0  # seconds for the other process; after that this one compiles for itself


def compile_kernels(gaussians: Gaussians, camera: Camera, options: TrainerOptions) -> None:
    """Have the kernels of all training steps compiled, where no earlier process has done it; changes no argument."""
    if not is_compiled(import_module("dofbench.kernels.rasterize.cpu_project_backward").project_backward):
        _compile_side_by_side(gaussians, camera, options)
    # What only later steps want would otherwise be compiled in the middle of training, on its clock.
    later: dict[Geometry, bool] = {
        "none": options.lens and (options.lens_model == "samples" or "model" in questions(options)),
        "full": options.normal_weight > 0,
        "distortion": options.distortion_weight > 0,
    }
    for geometry, wanted in later.items():
        if wanted:
            _rasterise_once(gaussians, camera, options, geometry)


def _rasterise_once(gaussians: Gaussians, camera: Camera, options: TrainerOptions, geometry: Geometry) -> None:
    statistics = ViewStatistics(want_abs=options.grow_absolute)
    # Numbers that aren't finite are training's to report.
    with contextlib.suppress(FloatingPointError):
        raster = rasterise(gaussians, camera, options, geometry=geometry, statistics=statistics)
        total = torch.stack([output.sum() for output in raster if output is not None]).sum()
        torch.autograd.grad(total, list(gaussians.parameters.values()), allow_unused=True)


def _compile_side_by_side(gaussians: Gaussians, camera: Camera, options: TrainerOptions) -> None:
    command = [sys.executable, "-P", "-m", "dofbench.gaussians.warmup", *(["lens"] if options.lens else [])]
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


def _compile_others(with_lens: bool) -> None:
    gc.disable()
    image = torch.rand((32, 32, 3), generator=torch.Generator().manual_seed(0)).requires_grad_()
    losses.reconstruction(image, torch.zeros_like(image), 0.2, None).backward()
    if with_lens:
        radius = torch.ones((32, 32)).requires_grad_()
        defocus(image, radius).sum().backward()


if __name__ == "__main__":
    _compile_others("lens" in sys.argv[1:])
