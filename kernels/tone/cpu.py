"""The tone curve on the CPU: float32, numba. torch's powers would take longer than the scatter."""

from __future__ import annotations

import numpy as np
import torch
from numba import njit, prange

from dofbench.runtime.kernel_cache import PRANGE, cached, cpu_backend, internal
from dofbench.runtime.simd import select8
from dofbench.runtime.simd_functions import exp2_fast8, log2_8, max8, min8
from dofbench.runtime.simd_memory import load8, store8

_LANES = 8
_CHUNK = 4096  # numbers per task
_INFINITY = np.float32(np.inf)
_LARGEST_EXPONENT = np.float32(126.0)


def tone(values, exponent, toe, slope):
    return _Power.apply(values, exponent, toe, slope)


class _Power(torch.autograd.Function):
    @staticmethod
    def forward(context, values, exponent, toe, slope):
        flat = values.contiguous().numpy().reshape(-1)
        constants = np.float32(exponent), np.float32(toe), np.float32(slope)
        result = _power(flat, *constants)
        context.kept = flat, result, constants
        return torch.from_numpy(result).reshape(values.shape)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context, gradient):
        flat, result, constants = context.kept
        by_values = _slope(gradient.contiguous().numpy().reshape(-1), flat, result, *constants)
        return torch.from_numpy(by_values).reshape(gradient.shape), None, None, None


@internal(error_model="numpy")
def _power8(x, exponent, toe, line):
    scaled = log2_8(max8(min8(x, _INFINITY), toe)) * exponent
    curve = exp2_fast8(max8(min8(scaled, _LARGEST_EXPONENT), -_LARGEST_EXPONENT))
    curve = select8(scaled > _LARGEST_EXPONENT, _INFINITY, curve)
    # log2_8 doesn't handle infinity and NaN; for these x ** exponent is x itself.
    return select8(x >= toe, select8(x < _INFINITY, curve, x), x * line)


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _power(values, exponent, toe, line):
    result = np.empty_like(values)
    size = values.size
    whole = size - size % _LANES
    for task in prange(-(-whole // _CHUNK)):
        for i in range(task * _CHUNK, min(whole, task * _CHUNK + _CHUNK), _LANES):
            store8(result, i, _power8(load8(values, i), exponent, toe, line))
    # The remaining values use the same vector arithmetic, so that a pixel's result doesn't depend on its place.
    # Value by value: an array assigned to a slice takes three seconds to compile.
    rest = np.ones(_LANES, np.float32)
    for i in range(whole, size):
        rest[i - whole] = values[i]
    store8(rest, 0, _power8(load8(rest, 0), exponent, toe, line))
    for i in range(whole, size):
        result[i] = rest[i - whole]
    return result


@cached
@njit(parallel=PRANGE, error_model="numpy")
def _slope(gradient, values, powers, exponent, toe, line):
    result = np.empty_like(gradient)
    for i in prange(values.size):
        result[i] = gradient[i] * (exponent * powers[i] / values[i] if values[i] >= toe else line)
    return result


def _warm_up(exponent: float = 2.0, toe: float = 0.5, slope: float = 0.5) -> None:
    values = torch.rand(64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    tone(values, exponent, toe, slope).sum().backward()


BACKEND = cpu_backend(_warm_up, _slope)
