"""Definition of a case: the property that must hold, its settings and error bound; and what measuring it gives."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dofbench.runtime.devices import kinds_here
from dofbench.runtime.ops import backend_of, backends, load, ops


@dataclass(frozen=True)
class Setting:
    """Backend, precision and device of a measurement.

    backend: a kernel's, or "numpy" for code without a kernel. precision: "float32" or "float64". device: as in torch.
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
        """The precision as a torch type."""
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
    """All settings of an op on this machine: every backend in each of its precisions on each of its devices."""
    return tuple(
        Setting(name, precision, device)
        for device in kinds_here()
        for name in reversed(backends(op))
        for precision in ("float64", "float32")
        if backend_of(op, name).takes(device, precision)
    )


# The settings of all ops. A case skips settings that its own op lacks.
KERNELS = tuple(dict.fromkeys(setting for op in ops() for setting in kernel_settings(op)))
SINGLE = tuple(setting for setting in KERNELS if setting.precision == "float32")
SINGLE_ON_CPU = tuple(setting for setting in SINGLE if setting.device == "cpu")
COMPILED = (Setting("cpu", "float32"),)
NUMPY = (Setting("numpy", "float32"),)
NUMPY64 = (Setting("numpy", "float64"),)
DOUBLE = Setting("reference", "float64")  # what float32 is compared with


@dataclass(frozen=True)
class Found:
    """The measured error and its bound. note: one line, or empty."""

    error: float
    bound: float
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the error is finite and at most the bound."""
        return math.isfinite(self.error) and self.error <= self.bound


@dataclass(frozen=True)
class Case:
    """A stiff or extreme case.

    name: unique within its group. subject: the op, the method's id, or other code under test. holds: the property that
    must hold. bound: the largest error, and its derivation. settings: those of them that this machine lacks are
    skipped. measure: runs the case.
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


@cache
def _texts() -> dict[str, dict[str, Any]]:
    return tomllib.loads(Path(__file__).with_name("cases.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Subject:
    """Makes the cases of one group that test one subject in the same settings.

    Property and bound of a case are looked up in cases.toml by group and name. prefix: precedes every name.
    """

    group: str
    subject: str
    settings: tuple[Setting, ...]
    prefix: str = ""

    def case(self, name: str, measure: Callable[..., Found], /, **options: Any) -> Case:
        """One case. Its measure is called with the setting and these options."""
        return self._made(name, {}, measure, options)

    def each(self, name: str, measure: Callable[..., Found], /, **options: Collection[Any]) -> tuple[Case, ...]:
        """A case for every combination of the options' values; the last option varies fastest.

        options: the values of each, or values by label. name and texts are formatted with the case's own values and
        labels: "{gamma:g}" is the option gamma, "{gamma_label}" the label of its value.
        """
        made = []
        for chosen in product(*(_labelled(values) for values in options.values())):
            one = {option: value for option, (_, value) in zip(options, chosen, strict=True)}
            labels = {f"{option}_label": label for option, (label, _) in zip(options, chosen, strict=True)}
            made.append(self._made(name, {**one, **labels}, measure, one))
        return tuple(made)

    def _made(self, name: str, given: dict[str, Any], measure: Callable[..., Found], options: dict[str, Any]) -> Case:
        holds, bound = _texts()[self.group][name]
        bound = _texts()["bounds"].get(bound, bound)
        called, holds, bound = (text.format(**given) for text in (name, holds, bound))
        run = partial(measure, **options) if options else measure
        return Case(self.group, self.prefix + called, self.subject, holds, bound, self.settings, run)


def _labelled(values: Collection[Any]) -> tuple[tuple[str, Any], ...]:
    return tuple(values.items()) if isinstance(values, Mapping) else tuple((str(value), value) for value in values)
