"""The declaration of a kernel op's backend."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Backend:
    """An implementation of a kernel op, declared as `BACKEND` in `kernels/<op>/<backend>.py` next to its functions.

    devices: kinds of device whose tensors the backend takes, as torch names them. dtypes: element types of those
    tensors, as torch names them ("float32"), the preferred one first. bits_repeat: whether the same call gives the same
    bits in every run, whatever the number of threads. warm_up: compiles the code that the op needs, by one small call
    and its gradient; it takes those of the op's options that decide which code is compiled. is_warm: whether that code
    was compiled before on this machine.
    """

    devices: tuple[str, ...]
    dtypes: tuple[str, ...]
    bits_repeat: bool
    warm_up: Callable[..., None] = lambda **_options: None
    is_warm: Callable[[], bool] = lambda: True

    def takes(self, device: str, dtype: str) -> bool:
        """Whether the backend takes tensors of this kind of device and element type."""
        return device in self.devices and dtype in self.dtypes

    def __str__(self) -> str:
        return f"{', '.join(self.dtypes)} on {', '.join(self.devices)}"
