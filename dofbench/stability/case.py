"""What a case is: what must hold, where it is run, how far off it may be and why; and what was found."""

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

from dofbench.compute.devices import kinds_here
from dofbench.kernels import backend_of, backends, load, ops


@dataclass(frozen=True)
class Setting:
    """Where a case is run.

    backend: a kernel's, or "numpy" for code without a kernel. precision: "float32" or "float64", of all that is
    computed. device: torch's.
    """

    backend: str
    precision: str
    device: str = "cpu"

    @property
    def label(self) -> str:
        """The backend, and the device where that isn't the CPU."""
        return self.backend if self.device == "cpu" else f"{self.backend}-{self.device}"

    @property
    def eps(self) -> float:
        """Distance of 1 to the next larger number: twice the largest relative error of one rounding."""
        return float(np.finfo(self.precision).eps)

    @property
    def dtype(self) -> torch.dtype:
        """The floating type as torch has it."""
        return torch.float64 if self.precision == "float64" else torch.float32

    def tensor(self, values: np.ndarray | float, *, gradient: bool = False) -> Tensor:
        """The values, contiguous, in this precision on this device."""
        array = np.ascontiguousarray(values)
        return torch.from_numpy(array).to(device=self.device, dtype=self.dtype, copy=True).requires_grad_(gradient)

    def kernel(self, op: str, function: str | None = None) -> Callable:
        """A kernel's function in this backend."""
        return load(op, self.backend, function=function)


@cache
def kernel_settings(op: str) -> tuple[Setting, ...]:
    """Every backend of a kernel's op, in every precision that it has, on every device here that it runs on."""
    return tuple(
        Setting(name, precision, device)
        for device in kinds_here()
        for name in reversed(backends(op))
        for precision in ("float64", "float32")
        if backend_of(op, name).takes(device, precision)
    )


# Of all ops; a case leaves out those that its own op doesn't have.
KERNELS = tuple(dict.fromkeys(setting for op in ops() for setting in kernel_settings(op)))
# The same in float32 alone, where the float64 reference is what is compared with.
SINGLE = tuple(setting for setting in KERNELS if setting.precision == "float32")
SINGLE_ON_CPU = tuple(setting for setting in SINGLE if setting.device == "cpu")
COMPILED = (Setting("cpu", "float32"),)
NUMPY = (Setting("numpy", "float32"),)
NUMPY64 = (Setting("numpy", "float64"),)
# What float32 is compared with.
DOUBLE = Setting("reference", "float64")


@dataclass(frozen=True)
class Found:
    """What a case measured. error must be at most bound; NaN and infinity never are. note: one line, or nothing."""

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

    name: unique within its group. subject: the kernel's op, the method's id, or what else is under test. holds: what
    must hold. bound: how far off it may be, and why. settings: where it is run; what isn't there is left out.
    measure: runs it.
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
        # A backend may be there for one op alone; a case of something else may need any op.
        tested = (self.subject,) if self.subject in ops() else ops()
        missing = {setting for setting in KERNELS if any(setting not in kernel_settings(op) for op in tested)}
        object.__setattr__(self, "settings", tuple(setting for setting in self.settings if setting not in missing))


def values(tensor: Tensor | np.ndarray) -> np.ndarray:
    """Any tensor or array as float64 on the host."""
    array = tensor.detach().cpu().numpy() if isinstance(tensor, Tensor) else np.asarray(tensor)
    return array.astype(np.float64)


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
    """Largest deviation of any number as a share of itself; where 0 is expected, nothing else will do."""
    a, b = values(found), values(expected)
    if a.shape != b.shape or not np.isfinite(a).all():
        return math.inf
    deviation = np.abs(a - b)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(deviation == 0, 0.0, deviation / np.abs(b))
    return float(share.max()) if share.size else 0.0


def differing(found: Tensor | np.ndarray, expected: Tensor | np.ndarray) -> float:
    """How many numbers aren't the very same; infinity for another shape. NaN is no number's equal."""
    a, b = values(found), values(expected)
    return float(np.count_nonzero(~(a == b))) if a.shape == b.shape else math.inf


def not_finite(*arrays: Tensor | np.ndarray | None) -> float:
    """How many numbers are NaN or infinite."""
    return float(sum(np.count_nonzero(~np.isfinite(values(array))) for array in arrays if array is not None))


def refuses(kind: type[Exception], call: Callable[[], object], *words: str) -> Found:
    """That the call raises this kind of error with all these words in it: 0 if it does, 1 if not."""
    try:
        call()
    except kind as error:
        message = " ".join(str(error).split())
        missing = [word for word in words if word not in message]
        return Found(float(len(missing)), 0.0, f"{kind.__name__}: {message}"[:160])
    return Found(1.0, 0.0, "went through without an error")


def in_folder(measure: Callable[..., Found]) -> Callable[..., Found]:
    """A measure that is given an empty folder of its own, in any setting."""

    @wraps(measure)
    def run(setting: Setting, **options: Any) -> Found:
        with tempfile.TemporaryDirectory(prefix="dofbench-stability-") as folder:
            return measure(Path(folder), **options)

    return run
