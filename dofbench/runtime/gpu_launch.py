"""Triton kernels: how they are found and launched, and a record of their launches.

Triton compiles kernels for CUDA tensors. Where `TRITON_INTERPRET=1` is set before the first kernel is loaded, Triton's
interpreter runs them on CPU tensors instead, slowly, which tests use on machines without a GPU. Triton isn't needed,
nor imported, before an op is called on a GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from dofbench.core.errors import InputError

_TYPES = {
    torch.float32: "fp32",
    torch.float16: "fp16",
    torch.float64: "fp64",
    torch.int64: "i64",
    torch.int32: "i32",
    torch.int16: "i16",
    torch.uint8: "u8",
    torch.bool: "i1",
}


@dataclass(frozen=True)
class Launch:
    """One way in which a kernel was launched: what has to be known to compile it for a GPU that isn't here.

    module, function: where the kernel is. signature: (argument, Triton's type) in order, "constexpr" for constants.
    constants: (argument, value). warps: groups of 32 threads in a program.
    """

    module: str
    function: str
    signature: tuple[tuple[str, str], ...]
    constants: tuple[tuple[str, Any], ...]
    warps: int


_recorded: dict[Launch, int] | None = None
_compiled: dict[tuple[Any, ...], Any] = {}


@cache
def kernels(module: str) -> ModuleType:
    """A module of Triton kernels, such as "tone.gpu_power". Raises InputError where Triton isn't installed."""
    try:
        import_module("triton")
    except ImportError as error:
        op = module.partition(".")[0]
        raise InputError(
            f"kernel {op} on a GPU", "no package triton", "the extra gpu: pip install dofbench[gpu]"
        ) from error
    return import_module(f"dofbench.runtime.ops.{module}")


def launch(kernel: Any, grid: tuple[int, ...], *arguments: Any, warps: int = 4, **constants: Any) -> None:
    """Run a Triton kernel: `grid` programs, on the device of its first tensor.

    arguments: tensors and numbers, in the order of the kernel's parameters. constants: its `tl.constexpr` parameters.
    """
    if 0 in grid:
        return
    first = _first_tensor(arguments)
    if _recorded is not None:
        one = _launch(kernel, arguments, constants, warps)
        _recorded[one] = _recorded.get(one, 0) + 1
    if not first.is_cuda or first.device.index == torch.cuda.current_device():
        run(kernel, grid, arguments, constants, warps)
    else:
        with torch.cuda.device(first.device):
            run(kernel, grid, arguments, constants, warps)


def run(kernel: Any, grid: tuple[int, ...], arguments: Sequence[Any], constants: dict[str, Any], warps: int) -> None:
    """Hand a launch over to Triton.

    From the second such launch on to what Triton compiled for the first: for each launch Triton looks anew for what it
    has compiled, which takes longer than most kernels do (docs/notes/gpu.md).
    """
    values = tuple(constants.values())
    key = kernel, _first_tensor(arguments).get_device(), warps, values, _kinds(arguments)
    if (compiled := _compiled.get(key)) is not None:
        compiled[(*grid, 1, 1)[:3]](*arguments, *values)
        return
    compiled = kernel[grid](*arguments, **constants, num_warps=warps)
    # The interpreter compiles nothing. A compiled kernel takes constants too, in the order of the parameters.
    if hasattr(compiled, "packed_metadata") and list(kernel.arg_names)[len(arguments) :] == list(constants):
        _compiled[key] = compiled


def _first_tensor(arguments: Sequence[Any]) -> Tensor:
    for argument in arguments:
        if isinstance(argument, Tensor):
            return argument
    raise ValueError("a kernel without a tensor among its arguments")


def _kinds(arguments: Sequence[Any]) -> tuple[Any, ...]:
    """What Triton's code for the arguments depends on: a tensor's type, and where it begins within 16 bytes; of others
    see `_kind`."""
    # Each launch goes through all its arguments, most of which are tensors: no call for these.
    return tuple([(one.dtype, one.data_ptr() & 15) if isinstance(one, Tensor) else _kind(one) for one in arguments])


def _kind(argument: Any) -> Any:
    """What Triton's code depends on of a whole number: whether it is 1 or a multiple of 16, and its range; of a float:
    nothing; of anything else: its value."""
    if type(argument) is not int:
        return float if type(argument) is float else (type(argument), argument)
    if -(2**31) <= argument < 2**31:
        return (argument == 1) + 2 * (argument & 15 == 0)
    return 4 + 2 * (argument & 15 == 0) + (argument >= 2**63)


@contextmanager
def recorded() -> Iterator[dict[Launch, int]]:
    """A block whose launches are recorded, each with how often it occurred."""
    global _recorded
    before, _recorded = _recorded, {}
    try:
        yield _recorded
    finally:
        _recorded = before


def _launch(kernel: Any, arguments: tuple[Any, ...], constants: dict[str, Any], warps: int) -> Launch:
    function: Callable[..., Any] = kernel.fn
    names = list(kernel.arg_names)
    types = {name: _type(value) for name, value in zip(names, arguments, strict=False)}
    types |= dict.fromkeys(constants, "constexpr")
    return Launch(
        function.__module__,
        function.__name__,
        tuple((name, types[name]) for name in names),
        tuple((name, constants[name]) for name in names if name in constants),
        warps,
    )


def _type(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"*{_TYPES[value.dtype]}"
    if isinstance(value, bool):
        return "i1"
    if isinstance(value, int):
        return "i32" if -(2**31) <= value < 2**31 else "i64"
    return "fp32"
