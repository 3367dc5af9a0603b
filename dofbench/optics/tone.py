"""The display encoding `linear = encoded ** gamma`, for arrays and tensors, optionally with a linear toe near black.

Near black there are two forms, which `toe` selects:

- The pure power (`toe=0`, the default) is what a dataset states of its photographs, and what renderers are compared
  with. It isn't differentiated.
- Where gradients pass, the pure power fails at black: the slope of `x ** (1 / gamma)` is infinite at 0, so one black
  pixel turns the gradient into infinity or NaN, and a tiny one dominates it. There the curve follows a straight line
  through zero below `TOE`, half a step of an 8-bit image, the least that such an image can mean. (The released code
  replaces exact zeros by 1e-5 instead, which leaves the slope at 1e5 ** (1 - 1 / gamma).) Negative values, of which the
  power is NaN, pass along the line.

The two differ only below `TOE`. An 8-bit image has no value there but 0, which both keep, so it is decoded alike; what
the two encode there rounds to level 0 of 8 bits alike. At gamma 2.2 they differ by at most 5.6e-4 of encoded white, or
37 of the 65535 levels of 16 bits, and by at most 3.2e-7 of linear white. So the difference shows in 16-bit photographs
alone: `dofbench.optics.defocus` encodes what it blurred with the toe, noise and photographs through a real lens are
encoded without. The bytes of existing datasets depend on this choice, so it stays.

`fast_decode` and `fast_encode` are the curves with the toe by a compiled kernel, if there is one, within 3e-6 of
`decode` and `encode`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from dofbench.core.lens import GAMMA
from dofbench.runtime.ops import load

if TYPE_CHECKING:
    from torch import Tensor

    Values = TypeVar("Values", np.ndarray, Tensor)

TOE = 0.5 / 255.0


def decode(encoded: Values, gamma: float = GAMMA, *, toe: float = 0.0) -> Values:
    """Encoded values to linear light: `encoded ** gamma`; below `toe`, if it isn't 0, a straight line through zero. Any
    shape."""
    return _power(encoded, gamma, toe, toe ** (gamma - 1.0) if toe else 0.0)


def encode(linear: Values, gamma: float = GAMMA, *, toe: float = 0.0) -> Values:
    """The inverse of `decode` with the same `toe`, which is an encoded value here too. Any shape; nothing is clipped at
    1."""
    return _power(linear, 1.0 / gamma, toe**gamma, toe ** (1.0 - gamma) if toe else 0.0)


def fast_decode(encoded: Tensor, gamma: float, backend: str = "auto") -> Tensor:
    """`decode` with the toe, by the kernel `tone`, compiled if there is a backend for such tensors.

    torch's own powers would take longer than the scatter. backend: of the kernel; "reference" uses torch's powers.
    """
    tone: Callable[..., Tensor] = load("tone", backend)
    return tone(encoded, gamma, TOE, TOE ** (gamma - 1.0))


def fast_encode(linear: Tensor, gamma: float, backend: str = "auto") -> Tensor:
    """`encode` with the toe, by the kernel `tone`; backend as in `fast_decode`."""
    tone: Callable[..., Tensor] = load("tone", backend)
    return tone(linear, 1.0 / gamma, TOE**gamma, TOE ** (1.0 - gamma))


def _power(values: Values, exponent: float, end: float, slope: float) -> Values:
    """`values ** exponent` from `end` up, `values * slope` below."""
    if end == 0:
        return values**exponent
    if isinstance(values, np.ndarray | np.generic):
        return np.where(values >= end, np.power(values.clip(end), exponent), values * slope)
    return load("tone", "reference")(values, exponent, end, slope)
