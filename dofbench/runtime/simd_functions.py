"""Functions of eight float32 lanes: exponential, logarithm, root, rounding, the smaller and the larger of two."""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing import signature
from numba.extending import intrinsic

from .kernel_cache import internal
from .simd import CONTRACT, FLOAT, FLOATS, INTS, LANES, as_floats, constant, float32x8, select8, vector_pair

LOG2_E = np.float32(1.4426950408889634)


def _call(builder, name, *operands):
    """Call LLVM's intrinsic `name` for eight floats."""
    kind = ir.FunctionType(FLOATS, [FLOATS] * len(operands))
    function = builder.module.globals.get(f"llvm.{name}.v8f32")
    if function is None:
        function = ir.Function(builder.module, kind, f"llvm.{name}.v8f32")
    return builder.call(function, operands)


def _polynomial(builder, x, coefficients):
    """Horner's rule; coefficients from the constant term up."""
    value = constant(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = builder.fadd(builder.fmul(value, x, flags=CONTRACT), constant(coefficient), flags=CONTRACT)
    return value


def _define_unary(name: str, doc: str, build):
    def function(typing_context, a):
        if a is not float32x8:
            return None
        return signature(float32x8, a), lambda context, builder, sig, args: build(builder, args[0])

    function.__name__, function.__doc__ = name, doc
    return intrinsic(function)


def _exp2(degree: int):
    """2**x by x = n + f, |f| <= 1/2: a polynomial for 2**f, and n added to its exponent bits."""
    half = np.cos(np.pi * (np.arange(64) + 0.5) / 64) / 2
    # Least squares at Chebyshev nodes, weighted to relative error; within 10 % of the minimax polynomial.
    powers = half[:, None] ** np.arange(1, degree + 1) / np.exp2(half)[:, None]
    tail = np.linalg.lstsq(powers, 1 - 1 / np.exp2(half), rcond=None)[0]
    coefficients = [1.0, *tail]

    def build(builder, x):
        whole = _call(builder, "rint", x)
        fraction = builder.fsub(x, whole, flags=CONTRACT)
        power = _polynomial(builder, fraction, coefficients)
        shift = builder.shl(builder.fptosi(whole, INTS), ir.Constant(INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(power, INTS), shift), FLOATS)

    return build


def _log2(builder, x):
    """log2(m 2**n) = n + (2 / ln 2) atanh((m - 1) / (m + 1)), m in [sqrt(1/2), sqrt(2))."""
    bits = builder.bitcast(x, INTS)
    root_half = int(np.float32(np.sqrt(0.5)).view(np.int32))
    start = builder.sub(bits, ir.Constant(INTS, [root_half] * LANES))
    exponent = builder.ashr(start, ir.Constant(INTS, [23] * LANES))
    mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, ir.Constant(INTS, [23] * LANES))), FLOATS)
    s = builder.fdiv(builder.fsub(mantissa, constant(1.0)), builder.fadd(mantissa, constant(1.0)))
    series = _polynomial(builder, builder.fmul(s, s), [2 / np.log(2) / n for n in (1, 3, 5, 7, 9)])
    return builder.fadd(builder.sitofp(exponent, FLOATS), builder.fmul(s, series), flags=CONTRACT)


exp2_fast8 = _define_unary(
    "exp2_fast8", "2**x to a relative 2e-7 for -126 <= x <= 126; outside of that, any finite number.", _exp2(5)
)
_exp2_8 = _define_unary("_exp2_8", "2**x to rounding for -126 <= x <= 126.", _exp2(7))
log2_8 = _define_unary("log2_8", "log2(x) to rounding, for positive normal x.", _log2)
floor8 = _define_unary("floor8", "Largest whole number not above x.", lambda builder, x: _call(builder, "floor", x))
sqrt8 = _define_unary("sqrt8", "Square root.", lambda builder, x: _call(builder, "sqrt", x))
_rint8 = _define_unary("_rint8", "Nearest whole number.", lambda builder, x: _call(builder, "rint", x))
abs8 = _define_unary("abs8", "Absolute value.", lambda builder, x: _call(builder, "fabs", x))


def _define_extremum(name: str, doc: str, symbol: str):
    def function(typing_context, a, b):
        if not vector_pair(a, b):
            return None

        def build(context, builder, sig, args):
            x, y = (as_floats(context, builder, value, kind) for value, kind in ((args[0], a), (args[1], b)))
            return builder.select(builder.fcmp_ordered(symbol, x, y), x, y)

        return signature(float32x8, a, b), build

    function.__name__, function.__doc__ = name, doc
    return intrinsic(function)


min8 = _define_extremum("min8", "The smaller; b where a is NaN.", "<")
max8 = _define_extremum("max8", "The larger; b where a is NaN.", ">")


@intrinsic
def floor_int(typing_context, number):
    """The largest whole number not above a float32, as int64; one instruction where `math.floor` is a call."""
    if number != types.float32:
        return None

    def build(context, builder, sig, args):
        kind = ir.FunctionType(FLOAT, [FLOAT])
        function = builder.module.globals.get("llvm.floor.f32") or ir.Function(builder.module, kind, "llvm.floor.f32")
        return builder.fptosi(builder.call(function, args), ir.IntType(64))

    return signature(types.int64, number), build


@internal(forceinline=True)
def exp8(x):
    """exp(x) to 2 units in the last place; 0 below -87, infinity above 88, NaN for NaN."""
    # The reduction in two parts of ln 2 keeps the bits that one product with log2(e) would lose.
    whole = _rint8(x * LOG2_E)
    rest = (x - whole * np.float32(0.693359375)) - whole * np.float32(-2.12194440e-4)
    power = _exp2_8(min8(max8(whole, np.float32(-126.0)), np.float32(126.0))) * _exp2_8(rest * LOG2_E)
    power = select8(x > np.float32(87.0), np.float32(np.inf), power)
    power = select8(x < np.float32(-87.0), np.float32(0.0), power)
    return select8(x == x, power, x)
