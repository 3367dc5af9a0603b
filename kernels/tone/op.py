"""Tone curves between encoded values and linear light."""

from __future__ import annotations

from torch import Tensor

from dofbench.runtime.ops import AUTO, implementation

__all__ = ["tone"]


def tone(values: Tensor, exponent: float, toe: float, slope: float, *, backend: str = AUTO) -> Tensor:
    """`values ** exponent` from `toe` up, and below it the straight line through zero of this slope.

    values: any shape; negative values lie on the line, nothing is clipped at 1. exponent, toe: positive, toe in the
    units of `values`. slope: `toe ** (exponent - 1)` makes line and power meet; it is an argument so that a curve and
    its inverse can have slopes whose product is exactly 1. Differentiable with respect to `values`: the line keeps the
    slope finite at 0, where that of a power below 1 is infinite. Compiled backends: relative error below 3e-6; NaN and
    infinity pass through.
    """
    return implementation("tone", backend, values=values).tone(values, exponent, toe, slope)
