"""The registry of kernel ops and their backends, which are the files `kernels/<op>/<backend>.py`.

An op is a folder: one function of the op's name (`ssim` and `stereo` have more), with the same signature in every
backend. A backend is a module of the folder without an underscore in its name, which declares in `BACKEND` the devices
and types that it takes; its parts are called `<backend>_<part>.py`. `reference` is written in plain torch, defines the
op, and exists for every op; another backend may exist for a single op. A backend is added by adding its file.

    blurred = load("scatter")(image, radius)      # the backend that suits the tensors
    exact = load("scatter", "reference")          # that backend

Nothing of an op is imported before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
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

__all__ = ["backend_of", "backends", "chosen", "is_warm", "load", "ops", "require", "runs_on", "warm_up"]
__path__ = [str(content_folder("kernels"))]

REFERENCE = "reference"


def ops() -> tuple[str, ...]:
    """Every op there is, sorted."""
    return tuple(sorted(_found(tuple(__path__))))


def backends(op: str) -> tuple[str, ...]:
    """The backends of an op, sorted, the reference last. Raises InputError for an unknown op."""
    found = _found(tuple(__path__))
    if op not in found:
        raise unknown("kernel", op, ops())
    return found[op]


def backend_of(op: str, backend: str) -> Backend:
    """What a backend of an op declares about itself; imports the backend. Raises InputError for an unknown backend."""
    declared: Backend = _module(op, backend).BACKEND
    return declared


def load(op: str, backend: str = "auto", *, function: str | None = None) -> Callable[..., Any]:
    """The function of kernel `op`.

    backend: a backend's name, or "auto", which chooses at each call: the first backend that takes the tensors' device
    and the first tensor's element type; the reference if no other backend takes them. function: name of another public
    function that the op has in every backend, for example `l1_ssim` of "ssim". Raises InputError for an unknown op or
    backend; so does a call with "auto" where no backend takes the tensors, or where they lie on several devices.
    """
    if backend != "auto":
        return _function(op, backend, function)
    backends(op)  # raises for an unknown op
    return partial(_dispatched, op, function)


def runs_on(op: str, device: str) -> bool:
    """Whether any backend of the op takes tensors of this kind of device, of some element type.

    Asks the reference first, because importing it loads no more than torch.
    """
    return any(device in backend_of(op, name).devices for name in reversed(backends(op)))


def require(op: str, device: str, who: str) -> None:
    """Raise InputError unless the op takes tensors of this kind of device. who: the caller, for the message."""
    if op not in ops():
        raise InputError(who, f"the kernel {op!r}", f"one of {', '.join(ops())}")
    if not runs_on(op, device):
        raise InputError(f"{who} on {device}", f"kernel {op} without a backend there", _offer(op))


def chosen(op: str, device: str = "cpu", dtype: str = "float32") -> str:
    """The backend that a call with such tensors gets: the first that takes them, the reference if no other does.

    Raises InputError where no backend of the op takes them.
    """
    for name in backends(op):
        if backend_of(op, name).takes(device, dtype):
            return name
    raise InputError(f"kernel {op}", f"tensors of {dtype} on {device}", _offer(op))


def warm_up(op: str, device: str = "cpu", dtype: str = "float32", **options: Any) -> None:
    """Compile the code that an op needs for such tensors, if it isn't compiled yet; options: see `Backend.warm_up`."""
    backend_of(op, chosen(op, device, dtype)).warm_up(**options)


def is_warm(op: str, device: str = "cpu", dtype: str = "float32") -> bool:
    """Whether an earlier process on this machine has compiled all that a warm-up of this op would compile."""
    return backend_of(op, chosen(op, device, dtype)).is_warm()


def _dispatched(op: str, function: str | None, *arguments: Any, **options: Any) -> Any:
    tensors = _tensors((*arguments, *options.values()))
    if not tensors:
        raise InputError(f"kernel {op}", "no tensor among its arguments", "at least one")
    device = tensors[0].device
    if any(tensor.device != device for tensor in tensors):
        devices = sorted({str(tensor.device) for tensor in tensors})
        raise InputError(f"kernel {op}", f"tensors on {' and '.join(devices)}", "all on one device")
    backend = _suiting(tuple(__path__), op, device.type, tensors[0].dtype)
    return _function(op, backend, function)(*arguments, **options)


def _tensors(arguments: Iterable[Any]) -> list[Tensor]:
    """Those among the arguments, and in sequences among them."""
    from torch import Tensor

    found = []
    for argument in arguments:
        if isinstance(argument, Tensor):
            found.append(argument)
        elif isinstance(argument, list | tuple):
            found += [one for one in argument if isinstance(one, Tensor)]
    return found


@cache
def _suiting(roots: tuple[str, ...], op: str, device: str, dtype: object) -> str:
    """The backend that such tensors get, which is kept, and so is its module: a training step on a GPU waits for the
    host, which would choose some twenty times a step. roots: where ops are, so that new ones are looked for."""
    return chosen(op, device, str(dtype).removeprefix("torch."))


def _offer(op: str) -> str:
    return "what a backend of it takes: " + "; ".join(f"{name}: {backend_of(op, name)}" for name in backends(op))


def _function(op: str, backend: str, function: str | None) -> Callable[..., Any]:
    found: Callable[..., Any] = getattr(_module(op, backend), function or op)
    return found


@cache
def _found(roots: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Op -> its backends, the reference last, as the files in these folders name them."""
    names: dict[str, set[str]] = {}
    for root in roots:
        for file in Path(root).glob("*/*.py"):
            if "_" not in file.stem:
                names.setdefault(file.parent.name, set()).add(file.stem)
    return {op: (*sorted(found - {REFERENCE}), REFERENCE) for op, found in names.items() if REFERENCE in found}


def _module(op: str, backend: str) -> ModuleType:
    return _imported(tuple(__path__), op, backend)


@cache
def _imported(roots: tuple[str, ...], op: str, backend: str) -> ModuleType:
    if backend not in backends(op):
        raise InputError(f"backend of kernel {op}", repr(backend), f"auto or one of {', '.join(backends(op))}")
    return import_module(f"dofbench.runtime.ops.{op}.{backend}")
