"""The bridge to `kernels/<op>/<backend>.py`: `load(op)` gives the op's function, loaded at first use.

A kernel op is one function, named after the op, with the same signature in every backend:
`reference` (plain torch, the definition, any floating type) and `cpu` (numba, float32).
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError

__path__ = [str(content_folder("kernels"))]

OPS = ("rasterize", "scatter", "ssim", "stereo")
BACKENDS = ("reference", "cpu")
_BY_DEVICE = {"cpu": "cpu", "cuda": "reference"}


def load(op: str, backend: str = "auto", device: str = "cpu", *, function: str | None = None) -> Callable:
    """The function of kernel `op` in `backend`; "auto" takes the fastest one for `device`.

    function: another public function that the op has in every backend, as `l1_ssim` of "ssim".
    Raises InputError for an unknown op or backend.
    """
    if op not in OPS:
        raise InputError("kernel", repr(op), f"one of {', '.join(OPS)}")
    if backend == "auto":
        backend = _BY_DEVICE[device.split(":")[0]]
    if backend not in BACKENDS:
        raise InputError(f"backend of kernel {op}", repr(backend), f"auto or one of {', '.join(BACKENDS)}")
    return getattr(import_module(f"dofbench.kernels.{op}.{backend}"), function or op)
