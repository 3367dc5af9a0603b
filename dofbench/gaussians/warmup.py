"""Compiling on two cores: a second process compiles the lens and the loss while this one does the rasteriser.

Numba compiles behind one lock, so only processes run side by side; the cache on disk is how one's work reaches
the other. On a machine that has compiled before nothing is started.
"""

from __future__ import annotations

import gc
import subprocess
import sys
from importlib import import_module

import torch

from dofbench.cameras import Camera
from dofbench.defocus import defocus
from dofbench.gaussians import losses
from dofbench.gaussians.model import Gaussians
from dofbench.gaussians.options import TrainerOptions
from dofbench.gaussians.render import rasterise
from dofbench.kernel_cache import is_compiled

_PATIENCE = 300.0  # seconds for the other process; after that this one compiles for itself


def compile_kernels(gaussians: Gaussians, camera: Camera, options: TrainerOptions) -> None:
    """Have the kernels of a training step compiled, where no earlier process has done it; changes no argument."""
    if is_compiled(import_module("dofbench.kernels.rasterize.cpu_project_backward").project_backward):
        return
    command = [sys.executable, "-P", "-m", "dofbench.gaussians.warmup", *(["lens"] if options.lens else [])]
    # A tenth of compiling is the garbage collector, which finds nothing.
    collecting = gc.isenabled()
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL) as other:
        try:
            gc.disable()
            raster = rasterise(gaussians, camera, options)
            torch.autograd.grad(raster.color.sum() + raster.depth.sum(), list(gaussians.parameters.values()),
                                allow_unused=True)
            other.wait(_PATIENCE)
        except (subprocess.TimeoutExpired, FloatingPointError):
            pass  # training compiles for itself what is missing, and reports numbers that aren't finite
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
