"""The soft edge of a circle of confusion and how far it reaches, for vectors and single pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from dofbench.runtime.simd_functions import exp2_fast8, max8, min8

_ONE = np.float32(1.0)
_LIMIT = np.float32(100.0)  # 1 / (1 + 2 ** +-100) is 0 or 1 in float32


@njit(error_model="numpy")
def logistic2(x):
    """1 / (1 + 2 ** x), eight lanes."""
    return _ONE / (_ONE + exp2_fast8(max8(min8(x, _LIMIT), -_LIMIT)))


@njit(error_model="numpy")
def half_width(radius, dy):
    """Half of the chord at `dy` from the centre, whole pixels; -1 where the circle doesn't reach that far."""
    rest = radius * radius - np.float32(dy) * np.float32(dy)
    return int(np.sqrt(rest)) if radius >= 0 and rest >= 0 else -1
