"""Definition of a case: the property that must hold, its settings and its error bound; and the outcome of measuring
it."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.runtime.devices import kinds_here
from dofbench.runtime.ops import backend_of, backends, load, ops


@dataclass(frozen=True)
class Setting:
    """Backend, precision and device in which a case is run.

    backend: a kernel's, or "numpy" for code without a kernel. precision: "float32" or "float64", that of the whole
    computation. device: as torch names it.
    """

    backend: str
    precision: str
    device: str = "cpu"

    @property
    def label(self) -> str:
        """The backend, followed by the device unless that is the CPU."""
        return self.backend if self.device == "cpu" else f"{self.backend}-{self.device}"

    @property
    def eps(self) -> float:
        """Distance from 1 to the next larger number: twice the largest relative error of one rounding."""
        return float(np.finfo(self.precision).eps)

    @property
    def dtype(self) -> torch.dtype:
        """The precision as torch's type."""
        return torch.float64 if self.precision == "float64" else torch.float32

    def tensor(self, values: np.ndarray | float, *, gradient: bool = False) -> Tensor:
        """The values, contiguous, in this precision on this device."""
        array = np.ascontiguousarray(values)
        return torch.from_numpy(array).to(device=self.device, dtype=self.dtype, copy=True).requires_grad_(gradient)

    def kernel(self, op: str, function: str | None = None) -> Callable[..., Any]:
        """A kernel's function in this backend."""
        return load(op, self.backend, function=function)


@cache
def kernel_settings(op: str) -> tuple[Setting, ...]:
    """All settings of a kernel's op on this machine: every backend, in each of its precisions, on each of its
    devices."""
    return tuple(
        Setting(name, precision, device)
        for device in kinds_here()
        for name in reversed(backends(op))
        for precision in ("float64", "float32")
        if backend_of(op, name).takes(device, precision)
    )


# The settings of all ops; a case leaves out settings that its own op doesn't have.
KERNELS = tuple(dict.fromkeys(setting for op in ops() for setting in kernel_settings(op)))
# The settings in float32 alone, for cases that are compared with the float64 reference.
SINGLE = tuple(setting for setting in KERNELS if setting.precision == "float32")
SINGLE_ON_CPU = tuple(setting for setting in SINGLE if setting.device == "cpu")
COMPILED = (Setting("cpu", "float32"),)
NUMPY = (Setting("numpy", "float32"),)
NUMPY64 = (Setting("numpy", "float64"),)
# What float32 is compared with.
DOUBLE = Setting("reference", "float64")


@dataclass(frozen=True)
class Found:
    """What a case measured. error must be at most bound; an error of NaN or infinity never is. note: one line, or
    empty."""

    error: float
    bound: float
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the bound is met."""
        return math.isfinite(self.error) and self.error <= self.bound


@dataclass(frozen=True)
class Case:
    """A stiff or extreme case.

    name: unique within its group. subject: the kernel's op, the method's id, or other code under test. holds: the
    property that must hold. bound: the largest error, and where this bound comes from. settings: those in which the
    case is run; settings that this machine lacks are left out. measure: runs the case.
    """

    group: str
    name: str
    subject: str
    holds: str
    bound: str
    settings: tuple[Setting, ...]
    measure: Callable[[Setting], Found]

    @property
    def id(self) -> str:
        """group/name."""
        return f"{self.group}/{self.name}"

    def __post_init__(self) -> None:
        # A backend may exist for some ops only. A case whose subject isn't an op may need any of them.
        tested = (self.subject,) if self.subject in ops() else ops()
        missing = {setting for setting in KERNELS if any(setting not in kernel_settings(op) for op in tested)}
        object.__setattr__(self, "settings", tuple(setting for setting in self.settings if setting not in missing))


def values(tensor: Tensor | np.ndarray) -> np.ndarray:
    """Any tensor or array as float64 on the host."""
    array = tensor.detach().cpu().numpy() if isinstance(tensor, Tensor) else np.asarray(tensor)
    return array.astype(np.float64)


def gradient_at(leaf: Tensor) -> np.ndarray:
    """The gradient that a backward pass left at a tensor, as float64 on the host."""
    assert leaf.grad is not None
    return values(leaf.grad)


def off(found: Tensor | np.ndarray, expected: Tensor | np.ndarray, scale: float | None = None) -> float:
    """Largest deviation, as a share of `scale`, by default the largest magnitude expected; infinity for NaN."""
    a, b = values(found), values(expected)
    if a.shape != b.shape:
        return math.inf
    if not a.size:
        return 0.0
    if not np.isfinite(a).all():
        return math.inf
    largest = float(np.abs(b).max()) if scale is None else scale
    deviation = float(np.abs(a - b).max())
    return deviation / largest if largest > 0 else (0.0 if deviation == 0 else math.inf)


def off_each(found: Tensor | np.ndarray, expected: Tensor | np.ndarray) -> float:
    """Largest deviation of any number as a share of itself; infinite if 0 is expected and another number is found."""
    a, b = values(found), values(expected)
    if a.shape != b.shape or not np.isfinite(a).all():
        return math.inf
    deviation = np.abs(a - b)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(deviation == 0, 0.0, deviation / np.abs(b))
    return float(share.max()) if share.size else 0.0


def differing(found: Tensor | np.ndarray, expected: Tensor | np.ndarray) -> float:
    """How many numbers aren't exactly equal; infinity for another shape. NaN isn't equal to any number."""
    a, b = values(found), values(expected)
    return float(np.count_nonzero(~(a == b))) if a.shape == b.shape else math.inf


def not_finite(*arrays: Tensor | np.ndarray | None) -> float:
    """How many numbers are NaN or infinite."""
    return float(sum(np.count_nonzero(~np.isfinite(values(array))) for array in arrays if array is not None))


def refuses(kind: type[Exception], call: Callable[[], object], *words: str) -> Found:
    """Measure whether the call raises this kind of error with all these words in its text: error 0 if so, else 1."""
    try:
        call()
    except kind as error:
        message = " ".join(str(error).split())
        missing = [word for word in words if word not in message]
        return Found(float(len(missing)), 0.0, f"{kind.__name__}: {message}"[:160])
    return Found(1.0, 0.0, "went through without an error")


def in_folder(measure: Callable[..., Found]) -> Callable[..., Found]:
    """A measure that ignores the setting and gets an empty temporary folder."""

    @wraps(measure)
    def run(setting: Setting, **options: Any) -> Found:
        with tempfile.TemporaryDirectory(prefix="dofbench-stability-") as folder:
            return measure(Path(folder), **options)

    return run
