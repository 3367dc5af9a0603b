"""A device that isn't there: tensors that say they lie on a GPU, and are computed on the CPU.

Inside `pretended()` torch makes, moves and combines tensors of the device "cuda" on a machine that has none. As with a
real one, a call refuses tensors of both devices, NumPy can't read the device's tensors, and what takes a number or a
shape from the device's values to the host has the host wait: each such wait of the project's code is recorded. Triton's
interpreter gets the tensors behind the pretended ones.

torch itself takes them for tensors of its device "meta", whose kinds of operation it dispatches without any support by
the machine; that every one of them then has values is this module's work.
"""

from __future__ import annotations

import importlib
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._mode_utils import no_dispatch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map_only

from dofbench.runtime import devices, gpu_launch

_META, _CUDA = torch.device("meta"), torch.device("cuda", 0)
_A_TEST = "a test"  # what waits there isn't the project's
_CODE = tuple(str(Path(__file__).resolve().parents[1] / folder) for folder in ("dofbench", "kernels"))
# Calls whose result's value or shape the host can't know before the device has computed it.
_WAITS = {"_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_dim", "equal"}


class Pretended(Tensor):
    """A tensor that says it lies on a GPU. host: the tensor that holds its values."""

    host: Tensor

    @staticmethod
    def __new__(cls, host: Tensor) -> Pretended:
        made = Tensor._make_wrapper_subclass(
            cls, host.shape, host.stride(), host.storage_offset(), dtype=host.dtype, device=_META
        )
        made.host = host
        return made

    @property
    def device(self) -> torch.device:  # type: ignore[override]
        """Where it says it lies."""
        return _CUDA

    def data_ptr(self) -> int:
        """Where a kernel finds its values."""
        return self.host.data_ptr()

    def numpy(self, *, force: bool = False) -> Any:
        """As of a GPU's tensor."""
        if not force:
            raise TypeError("can't convert a tensor on cuda:0 to numpy")
        return self.cpu().detach().numpy()

    def tolist(self) -> Any:
        """The values; torch's own refuses kinds of tensor."""
        return self.cpu().tolist()

    @classmethod
    def __torch_dispatch__(cls, function, types, arguments=(), options=None):
        return _computed(function, arguments, options or {})


_waits: list[str] = []


def _computed(function: Any, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
    """The result of one of torch's operations, on the device if an argument or `device` is."""
    name = function.name().removeprefix("aten::").partition(".")[0]
    tensors = [one for one in tree_leaves((arguments, options)) if isinstance(one, Tensor)]
    there = [one for one in tensors if isinstance(one, Pretended)]
    here = [one for one in tensors if not isinstance(one, Pretended)]
    options = dict(options)
    on_device = bool(there)
    if options.get("device") is not None:
        on_device = torch.device(options["device"]).type != "cpu"
        options["device"] = torch.device("cpu")
    if there and any(one.ndim for one in here) and name != "copy_":
        raise RuntimeError(f"{name}: tensors on cpu and on cuda:0, in {_place()}")
    by_mask = name in ("index", "index_put_") and any(
        one.dtype == torch.bool for one in tree_leaves(arguments[1]) if isinstance(one, Tensor)
    )
    unknown_length = name == "repeat_interleave" and options.get("output_size") is None
    brought = (name == "_to_copy" and not on_device) or (name == "copy_" and not isinstance(arguments[0], Pretended))
    # torch waits for the whole device after a copy to it, unless the copy is asked not to block.
    blocking = not options.get("non_blocking") and not (name == "copy_" and True in arguments[2:])
    sent = on_device and bool(here) and blocking and name in ("_to_copy", "copy_")
    if (there and (name in _WAITS or by_mask or unknown_length or brought)) or sent:
        place = _place()
        if place != _A_TEST:
            _waits.append(f"{name} in {place}")
    given, named = (tree_map_only(Pretended, lambda one: one.host, each) for each in (arguments, options))
    result = function(*given, **named)
    if torch.Tag.inplace_view in function.tags:  # the tensor that says where it lies has a shape of its own
        with no_dispatch():
            function(*arguments, **options)
    changed = [
        options.get(one.name, argument)
        for one, argument in zip(function._schema.arguments, (*arguments, *options.values()), strict=False)
        if one.alias_info is not None and one.alias_info.is_write
    ]
    returned = function._schema.returns
    if changed and returned and returned[0].alias_info is not None and returned[0].alias_info.is_write:
        return changed[0] if len(returned) == 1 else tuple(changed)
    return tree_map_only(Tensor, Pretended, result) if on_device else result


def _place() -> str:
    """The innermost line of this project that is running."""
    inside = [frame for frame in traceback.extract_stack() if frame.filename.startswith(_CODE)]
    return f"{Path(inside[-1].filename).name} {inside[-1].name}" if inside else _A_TEST


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(self, function, types, arguments=(), options=None):
        return _computed(function, arguments, options or {})


class _Names(TorchFunctionMode):
    """Turns the device's name into that of the device that torch dispatches."""

    def __torch_function__(self, function, types, arguments=(), options=None):
        arguments = [_known(one) for one in arguments]
        options = {name: _known(one) for name, one in (options or {}).items()}
        if function is torch.tensor and options.get("device") == _META:
            del options["device"]
            return torch.tensor(*arguments, **options).to(_META)
        if function is Tensor.new_tensor and isinstance(arguments[0], Pretended):
            return torch.tensor(*arguments[1:], **{"dtype": arguments[0].dtype, **options}).to(_META)
        return function(*arguments, **options)


def _known(one: Any) -> Any:
    is_device = (isinstance(one, torch.device) and one.type == "cuda") or (isinstance(one, str) and one[:4] == "cuda")
    return _META if is_device else one


@contextmanager
def pretended(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """A block with a GPU; yields the list of waits, each with the operation and the function that it is in, which grows
    while the block runs."""
    run = gpu_launch.run

    def interpreted(kernel, grid, arguments, constants, warps):
        run(kernel, grid, [one.host if isinstance(one, Pretended) else one for one in arguments], constants, warps)

    monkeypatch.setattr(gpu_launch, "run", interpreted)
    interpreter = importlib.import_module("triton.runtime.interpreter")
    # The interpreter's own check of sums of whole numbers takes a third of the time, and kernels' own tests have it.
    options = interpreter.InterpreterOptions(sanitize_overflow=False)
    monkeypatch.setattr(interpreter.interpreter_builder, "options", options)
    monkeypatch.setattr(devices, "count", lambda kind: 1)
    monkeypatch.setattr(torch.cuda, "reset_peak_memory_stats", lambda device=None: None)
    monkeypatch.setattr(torch.cuda, "max_memory_allocated", lambda device=None: 5_000_000)
    # Within a backward pass torch itself looks for the device that a new tensor is to lie on, before `_Operations`.
    monkeypatch.setattr(torch.cuda, "_lazy_init", lambda: None)
    _waits.clear()
    with _Names(), _Operations():
        yield _waits
