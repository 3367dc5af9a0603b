"""The display encoding `linear = encoded ** gamma`, for arrays and tensors, optionally with a linear toe near black.

- Without a toe (`toe=0`, the default): the pure power, a dataset's encoding. It isn't differentiated.
- With a toe: a straight line through zero below `TOE`, half a step of an 8-bit image. The slope of `x ** (1 / gamma)`
is
  infinite at 0, so one black pixel would make gradients infinite or NaN. (The released code replaces exact zeros by
  1e-5, which leaves a slope of 1e5 ** (1 - 1 / gamma).) Negative values follow the line.

The two differ only below `TOE`, at gamma 2.2 by at most 5.6e-4 of encoded white (37 of 65535 levels of 16 bits) and
3.2e-7 of linear white; 8-bit images don't show it. `dofbench.optics.defocus` encodes with the toe, noise and ray-traced
images are encoded without. The bytes of existing datasets depend on this choice.

`fast_decode` and `fast_encode` are the curves with the toe by a compiled kernel, within 3e-6 of `decode` and `encode`.
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
    """Encoded values to linear light: `encoded ** gamma`, below `toe` a straight line through zero. Any shape."""
    return _power(encoded, gamma, toe, toe ** (gamma - 1.0) if toe else 0.0)


def encode(linear: Values, gamma: float = GAMMA, *, toe: float = 0.0) -> Values:
    """The inverse of `decode` with the same (encoded) `toe`. Any shape; nothing is clipped at 1."""
    return _power(linear, 1.0 / gamma, toe**gamma, toe ** (1.0 - gamma) if toe else 0.0)


def fast_decode(encoded: Tensor, gamma: float, backend: str = "auto") -> Tensor:
    """`decode` with the toe by the kernel `tone`: torch's powers take longer than the scatter. backend: of the
    kernel."""
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
