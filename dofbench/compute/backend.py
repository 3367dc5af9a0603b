"""What one implementation of a kernel op says about itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


def _nothing(**_options: Any) -> None:
    """The warm-up of a backend that compiles nothing."""


def _always() -> bool:
    return True


@dataclass(frozen=True)
class Backend:
    """Declared as `BACKEND` in `kernels/<op>/<backend>.py`, beside the op's functions.

    devices: kinds of device whose tensors it takes, as torch names them. dtypes: their element types, as torch names
    them ("float32"), the best first. bits_repeat: whether the same call gives the same bits in every run, whatever the
    number of threads.
    warm_up: compiles what the op's calls need, by one small call and its gradient; options are the op's own, where they
    decide what is compiled. is_warm: whether that was done before on this machine.
    """

    devices: tuple[str, ...]
    dtypes: tuple[str, ...]
    bits_repeat: bool
    warm_up: Callable[..., None] = _nothing
    is_warm: Callable[[], bool] = _always

    def takes(self, device: str, dtype: str) -> bool:
        """Whether it runs on tensors of this kind of device and element type."""
        return device in self.devices and dtype in self.dtypes

    def __str__(self) -> str:
        return f"{', '.join(self.dtypes)} on {', '.join(self.devices)}"
