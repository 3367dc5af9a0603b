"""The registry of kernel ops.

An op is a folder of `kernels/`. `op.py` owns the op's public functions (`__all__`; the first has the op's name):
signature, documentation, argument checks. Each other module without an underscore in its name is a backend, which
implements these functions and declares in `BACKEND` the devices and types that it takes; its parts are called
`<backend>_<part>.py`. `reference` is plain torch, defines the op and exists for every op. A backend is added by adding
its file.

    blurred = load("scatter")(image, radius)      # the backend that suits the tensors
    exact = load("scatter", "reference")          # that backend

Nothing of an op is imported before it is loaded, no backend before it is called.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from dofbench.core.content import content_folder
from dofbench.core.errors import InputError, unknown
from dofbench.runtime.backend import Backend

if TYPE_CHECKING:
    from torch import Tensor

__all__ = [
    "AUTO", "backend_of", "backends", "chosen", "functions", "implementation", "is_warm", "load", "ops", "require",
    "runs_on", "warm_up",
]  # fmt: skip
__path__ = [str(content_folder("kernels"))]

AUTO = "auto"
_DEFINITION, _REFERENCE = "op", "reference"


def ops() -> tuple[str, ...]:
    """Every op, sorted."""
    return tuple(sorted(file.parent.name for root in __path__ for file in Path(root).glob(f"*/{_DEFINITION}.py")))


@cache
def backends(op: str) -> tuple[str, ...]:
    """The backends of an op, sorted, the reference last. Raises InputError for an unknown op."""
    if op not in ops():
        raise unknown("kernel", op, ops())
    names = {file.stem for root in __path__ for file in (Path(root) / op).glob("*.py") if "_" not in file.stem}
    return *sorted(names - {_DEFINITION, _REFERENCE}), _REFERENCE


@cache
def _module(op: str, name: str) -> ModuleType:
    if name != _DEFINITION and name not in backends(op):
        raise unknown(f"backend of kernel {op}", name, (AUTO, *backends(op)))
    return import_module(f"dofbench.runtime.ops.{op}.{name}")


def functions(op: str) -> tuple[str, ...]:
    """The public functions of an op; the first has the op's name. Raises InputError for an unknown op."""
    backends(op)
    return tuple(_module(op, _DEFINITION).__all__)


def backend_of(op: str, name: str) -> Backend:
    """The declaration of a backend; imports it. Raises InputError for an unknown op or backend."""
    return _module(op, name).BACKEND


def load(op: str, backend: str = AUTO, *, function: str | None = None) -> Callable[..., Any]:
    """A public function of an op (default: the one of the op's name), as `kernels/<op>/op.py` documents it.

    backend: a backend's name, or "auto", which chooses by the tensors at each call: the first backend that takes their
    device and element type. Raises InputError for an unknown op, function or backend; a call raises it where no backend
    takes the tensors.
    """
    name = function or op
    if name not in functions(op):
        raise unknown(f"function of kernel {op}", name, functions(op))
    found: Callable[..., Any] = getattr(_module(op, _DEFINITION), name)
    if backend == AUTO:
        return found
    _module(op, backend)
    return partial(found, backend=backend)


def implementation(op: str, backend: str, **tensors: Tensor | None) -> Any:
    """The backend module that computes a call: `backend`, or the one that suits the tensors for "auto".

    tensors: the call's floating-point tensors by argument name, the first not None. A training step on a GPU waits for
    the host, which calls this some twenty times a step, so the choice is cached. Raises ValueError for tensors of
    several types or devices, InputError for tensors that the backend doesn't take.
    """
    name, first = next(iter(tensors.items()))
    assert first is not None
    dtype, device = first.dtype, first.device
    for other, tensor in tensors.items():
        if tensor is not None and (tensor.dtype != dtype or tensor.device != device):
            found = f"{tensor.dtype} on {tensor.device}"
            raise ValueError(f"{op} {other}: expected {dtype} on {device} like {name}, found {found}")
    return _suiting(op, backend, device.type, dtype)


@cache
def _suiting(op: str, backend: str, device: str, dtype: object) -> ModuleType:
    kind = str(dtype).removeprefix("torch.")
    if backend == AUTO:
        return _module(op, chosen(op, device, kind))
    declared = backend_of(op, backend)
    # Triton's interpreter runs a GPU's kernels on tensors of the CPU.
    on = "cuda" if os.environ.get("TRITON_INTERPRET") == "1" and "cpu" not in declared.devices else device
    if not declared.takes(on, kind):
        raise InputError(f"kernel {op}, backend {backend}", f"{kind} on {device}", str(declared))
    return _module(op, backend)


def chosen(op: str, device: str = "cpu", dtype: str = "float32") -> str:
    """The backend that a call with such tensors gets: the first that takes them.

    Raises InputError where no backend of the op takes them.
    """
    for name in backends(op):
        if backend_of(op, name).takes(device, dtype):
            return name
    raise InputError(f"kernel {op}", f"tensors of {dtype} on {device}", _offer(op))


def runs_on(op: str, device: str) -> bool:
    """Whether any backend of the op takes tensors of this kind of device, of some element type."""
    # The reference first, because importing it loads no more than torch.
    return any(device in backend_of(op, name).devices for name in reversed(backends(op)))


def require(op: str, device: str, who: str) -> None:
    """Raise InputError unless the op takes tensors of this kind of device. who: the caller, for the message."""
    if op not in ops():
        raise InputError(who, f"the kernel {op!r}", f"one of {', '.join(ops())}")
    if not runs_on(op, device):
        raise InputError(f"{who} on {device}", f"kernel {op} without a backend there", _offer(op))


def warm_up(op: str, device: str = "cpu", dtype: str = "float32", **options: Any) -> None:
    """Compile the code that an op needs for such tensors, if it isn't compiled yet; options: see `Backend.warm_up`."""
    backend_of(op, chosen(op, device, dtype)).warm_up(**options)


def is_warm(op: str, device: str = "cpu", dtype: str = "float32") -> bool:
    """Whether an earlier process on this machine has compiled all that a warm-up of this op would compile."""
    return backend_of(op, chosen(op, device, dtype)).is_warm()


def _offer(op: str) -> str:
    return "; ".join(f"{name}: {backend_of(op, name)}" for name in backends(op))
