"""Display encoding on the CPU: powers with a straight toe, which as torch operations cost more than the scatter."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange
from torch import Tensor

from dofbench.compute.kernel_cache import cached
from dofbench.compute.simd import exp2_fast8, load8, log2_8, max8, min8, select8, store8

_LANES = 8
_CHUNK = 4096  # numbers of a task
_INFINITY = np.float32(np.inf)
_LARGEST_EXPONENT = np.float32(126.0)


def power_with_toe(values: Tensor, exponent: float, toe: float) -> Tensor:
    """`values ** exponent` from `toe` up, a straight line through zero below it; any shape, float32 on the CPU.

    toe: positive. Differentiable. Relative error below 3e-6; infinity and NaN pass.
    """
    return _Power.apply(values, exponent, toe)


class _Power(torch.autograd.Function):
    @staticmethod
    def forward(context, values, exponent, toe):
        flat = values.contiguous().numpy().reshape(-1)
        constants = np.float32(exponent), np.float32(toe), np.float32(toe ** (exponent - 1.0))
        result = _power(flat, *constants)
        context.kept = flat, result, constants
        return torch.from_numpy(result).reshape(values.shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        flat, result, constants = context.kept
        by_values = _slope(gradient.contiguous().numpy().reshape(-1), flat, result, *constants)
        return torch.from_numpy(by_values).reshape(gradient.shape), None, None


@njit(error_model="numpy")
def _power8(x, exponent, toe, line):
    scaled = log2_8(max8(min8(x, _INFINITY), toe)) * exponent
    curve = exp2_fast8(max8(min8(scaled, _LARGEST_EXPONENT), -_LARGEST_EXPONENT))
    curve = select8(scaled > _LARGEST_EXPONENT, _INFINITY, curve)
    # The bits of infinity and NaN mean nothing to log2_8; x ** exponent is x itself there.
    return select8(x >= toe, select8(x < _INFINITY, curve, x), x * line)


@cached
@njit(parallel=True, error_model="numpy")
def _power(values, exponent, toe, line):
    result = np.empty_like(values)
    size = values.size
    whole = size - size % _LANES
    for task in prange(-(-whole // _CHUNK)):
        for i in range(task * _CHUNK, min(whole, task * _CHUNK + _CHUNK), _LANES):
            store8(result, i, _power8(load8(values, i), exponent, toe, line))
    # The rest goes through the same arithmetic, so that a pixel's value doesn't depend on its place.
    rest = np.ones(_LANES, np.float32)
    rest[: size - whole] = values[whole:]
    store8(rest, 0, _power8(load8(rest, 0), exponent, toe, line))
    result[whole:] = rest[: size - whole]
    return result


@cached
@njit(parallel=True, error_model="numpy")
def _slope(gradient, values, powers, exponent, toe, line):
    result = np.empty_like(gradient)
    for i in prange(values.size):
        result[i] = gradient[i] * (exponent * powers[i] / values[i] if values[i] >= toe else line)
    return result
