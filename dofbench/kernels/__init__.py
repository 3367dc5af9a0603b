"""The bridge to `kernels/<op>/<backend>.py`, and the registry of what lies there.

An op is a folder: one function of the op's name (`ssim` and `stereo` have more), with the same signature in every
backend. A backend is a module of the folder without an underscore in its name, which declares in `BACKEND` what it runs
on; its parts are called `<backend>_<part>.py`. `reference` is plain torch, the definition, and there for every op; any
other backend may be there for one op alone. Adding one is adding its file.

    blurred = load("scatter")(image, radius)      # the backend that suits the tensors
    exact = load("scatter", "reference")          # that backend

Nothing of an op is imported before it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from dofbench.compute.backend import Backend
from dofbench.core.content import content_folder
from dofbench.core.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

__all__ = ["backend_of", "backends", "is_warm", "load", "ops", "require", "runs_on", "warm_up"]
__path__ = [str(content_folder("kernels"))]

REFERENCE = "reference"


def ops() -> tuple[str, ...]:
    """Every op there is, sorted."""
    return tuple(sorted(_found(tuple(__path__))))


def backends(op: str) -> tuple[str, ...]:
    """The backends of an op, sorted, the reference last. Raises InputError for an unknown op."""
    found = _found(tuple(__path__))
    if op not in found:
        raise InputError("kernel", repr(op), f"one of {', '.join(ops())}")
    return found[op]


def backend_of(op: str, backend: str) -> Backend:
    """What a backend of an op says about itself; imports it. Raises InputError for an unknown one."""
    declared: Backend = _module(op, backend).BACKEND
    return declared


def load(op: str, backend: str = "auto", *, function: str | None = None) -> Callable[..., Any]:
    """The function of kernel `op`.

    backend: "auto" chooses at each call by the tensors that are passed: the first backend that takes their device and
    the first one's element type, and the reference if no other does. Or a backend's name.
    function: another public function that the op has in every backend, as `l1_ssim` of "ssim".
    Raises InputError for an unknown op or backend; so does a call with "auto" where no backend takes the tensors, or
    where they lie on several devices.
    """
    if backend != "auto":
        return _function(op, backend, function)
    backends(op)  # raises for an unknown op
    return partial(_dispatched, op, function)


def runs_on(op: str, device: str) -> bool:
    """Whether any backend of the op takes tensors of this kind of device, of some element type.

    Asks the reference first, which imports nothing but torch.
    """
    return any(device in backend_of(op, name).devices for name in reversed(backends(op)))


def require(op: str, device: str, who: str) -> None:
    """Raise InputError unless `who`, who calls the op, can do so with tensors of this kind of device."""
    if op not in ops():
        raise InputError(who, f"the kernel {op!r}", f"one of {', '.join(ops())}")
    if not runs_on(op, device):
        raise InputError(f"{who} on {device}", f"kernel {op} without a backend there", _offer(op))


def warm_up(op: str, device: str = "cpu", dtype: str = "float32", **options: Any) -> None:
    """Compile what calls of an op with such tensors need, where that isn't done; options: see `Backend.warm_up`."""
    backend_of(op, _chosen(op, device, dtype)).warm_up(**options)


def is_warm(op: str, device: str = "cpu", dtype: str = "float32") -> bool:
    """Whether a warm-up of this op found everything compiled, on this machine, by an earlier process."""
    return backend_of(op, _chosen(op, device, dtype)).is_warm()


def _dispatched(op: str, function: str | None, *arguments: Any, **options: Any) -> Any:
    tensors = list(_tensors((*arguments, *options.values())))
    if not tensors:
        raise InputError(f"kernel {op}", "no tensor among its arguments", "at least one")
    devices = sorted({str(tensor.device) for tensor in tensors})
    if len(devices) > 1:
        raise InputError(f"kernel {op}", f"tensors on {' and '.join(devices)}", "all on one device")
    first = tensors[0]
    chosen = _chosen(op, first.device.type, str(first.dtype).removeprefix("torch."))
    return _function(op, chosen, function)(*arguments, **options)


def _tensors(arguments: tuple[Any, ...]) -> Iterator[Tensor]:
    import torch

    return (argument for argument in arguments if isinstance(argument, torch.Tensor))


def _chosen(op: str, device: str, dtype: str) -> str:
    for name in backends(op):
        if backend_of(op, name).takes(device, dtype):
            return name
    raise InputError(f"kernel {op}", f"tensors of {dtype} on {device}", _offer(op))


def _offer(op: str) -> str:
    return "what a backend of it takes: " + "; ".join(f"{name}: {backend_of(op, name)}" for name in backends(op))


def _function(op: str, backend: str, function: str | None) -> Callable[..., Any]:
    found: Callable[..., Any] = getattr(_module(op, backend), function or op)
    return found


@cache
def _found(roots: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Op -> its backends, the reference last, by the files in these folders."""
    names: dict[str, set[str]] = {}
    for root in roots:
        for file in Path(root).glob("*/*.py"):
            if "_" not in file.stem:
                names.setdefault(file.parent.name, set()).add(file.stem)
    return {op: (*sorted(found - {REFERENCE}), REFERENCE) for op, found in names.items() if REFERENCE in found}


def _module(op: str, backend: str) -> ModuleType:
    if backend not in backends(op):
        raise InputError(f"backend of kernel {op}", repr(backend), f"auto or one of {', '.join(backends(op))}")
    return import_module(f"dofbench.kernels.{op}.{backend}")
