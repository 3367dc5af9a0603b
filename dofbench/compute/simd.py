"""Eight float32 lanes as one numba value: kernels are vectorised explicitly, whatever the compiler's auto-vectoriser
does.

`Float32x8` is LLVM's `<8 x float>`: one register with AVX, two with SSE or NEON. Values exist only
inside compiled functions. `+ - * /`, unary minus, comparisons (giving a mask) and `& | ~` on masks
work as for numbers; a scalar on either side is broadcast. Multiplications and additions may be
contracted to fused ones; nothing else is reordered, so NaN and infinity behave as IEEE 754 says.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core.typing import signature
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable
from numba.np.arrayobj import make_array

LANES = 8
LOG2_E = np.float32(1.4426950408889634)

_FLOAT = ir.FloatType()
_INT = ir.IntType(32)
_FLOATS = ir.VectorType(_FLOAT, LANES)
_INTS = ir.VectorType(_INT, LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)
_CONTRACT = ("contract",)


class Float32x8(types.Type):
    """Eight float32 numbers."""

    def __init__(self) -> None:
        super().__init__(name="Float32x8")


class Mask8(types.Type):
    """Eight truth values, from comparing `Float32x8`."""

    def __init__(self) -> None:
        super().__init__(name="Mask8")


float32x8 = Float32x8()
mask8 = Mask8()


@register_model(Float32x8)
class _Float32x8Model(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _FLOATS)


@register_model(Mask8)
class _Mask8Model(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _BITS)


# ---------------------------------------------------------------------------------------------- building blocks


def _constant(number: float) -> ir.Constant:
    return ir.Constant(_FLOATS, [float(np.float32(number))] * LANES)


def _lane(index: int) -> ir.Constant:
    return ir.Constant(_INT, index)


def _splat(builder, scalar):
    vector = builder.insert_element(ir.Constant(_FLOATS, ir.Undefined), scalar, _lane(0))
    return builder.shuffle_vector(vector, ir.Constant(_FLOATS, ir.Undefined), ir.Constant(_INTS, [0] * LANES))


def _as_floats(context, builder, value, kind):
    if kind is float32x8:
        return value
    return _splat(builder, context.cast(builder, value, kind, types.float32))


def _call(builder, name, *operands):
    """Call LLVM's intrinsic `name` for eight floats."""
    kind = ir.FunctionType(_FLOATS, [_FLOATS] * len(operands))
    function = builder.module.globals.get(f"llvm.{name}.v8f32")
    if function is None:
        function = ir.Function(builder.module, kind, f"llvm.{name}.v8f32")
    return builder.call(function, operands)


def _polynomial(builder, x, coefficients):
    """Horner's rule; coefficients from the constant term up."""
    value = _constant(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = builder.fadd(builder.fmul(value, x, flags=_CONTRACT), _constant(coefficient), flags=_CONTRACT)
    return value


def _pointer(context, builder, array_type, array, index, index_type):
    data = make_array(array_type)(context, builder, array).data
    return builder.gep(data, [context.cast(builder, index, index_type, types.intp)], inbounds=True)


def _is_number(kind) -> bool:
    return isinstance(kind, types.Float)


def _is_flat(array, number) -> bool:
    return isinstance(array, types.Array) and array.dtype == number and array.layout == "C" and array.ndim == 1


def _is_flat_float32(array) -> bool:
    return _is_flat(array, types.float32)


# ---------------------------------------------------------------------------------------------- operators


def _vector_pair(a, b) -> bool:
    return (a is float32x8 and (b is float32x8 or _is_number(b))) or (b is float32x8 and _is_number(a))


def _define_binary(op, result, build) -> None:
    @type_callable(op)
    def typer_of(context):
        def typer(a, b):
            return result if _vector_pair(a, b) else None

        return typer

    def lower(context, builder, sig, args):
        a, b = (_as_floats(context, builder, value, kind) for value, kind in zip(args, sig.args, strict=True))
        return build(builder, a, b)

    for pair in ((Float32x8, Float32x8), (Float32x8, types.Float), (types.Float, Float32x8)):
        lower_builtin(op, *pair)(lower)


for _op in (operator.add, operator.iadd):
    _define_binary(_op, float32x8, lambda builder, a, b: builder.fadd(a, b, flags=_CONTRACT))
for _op in (operator.sub, operator.isub):
    _define_binary(_op, float32x8, lambda builder, a, b: builder.fsub(a, b, flags=_CONTRACT))
for _op in (operator.mul, operator.imul):
    _define_binary(_op, float32x8, lambda builder, a, b: builder.fmul(a, b, flags=_CONTRACT))
_define_binary(operator.truediv, float32x8, lambda builder, a, b: builder.fdiv(a, b))
for _symbol, _op in (("<", operator.lt), ("<=", operator.le), (">", operator.gt), (">=", operator.ge)):
    _define_binary(_op, mask8, lambda builder, a, b, s=_symbol: builder.fcmp_ordered(s, a, b))
_define_binary(operator.eq, mask8, lambda builder, a, b: builder.fcmp_ordered("==", a, b))


@type_callable(operator.neg)
def _type_neg(context):
    return lambda a: float32x8 if a is float32x8 else None


@lower_builtin(operator.neg, Float32x8)
def _lower_neg(context, builder, sig, args):
    return builder.fsub(_constant(-0.0), args[0])


def _define_mask_operator(op, build) -> None:
    @type_callable(op)
    def typer_of(context):
        return lambda a, b: mask8 if a is mask8 and b is mask8 else None

    @lower_builtin(op, Mask8, Mask8)
    def lower(context, builder, sig, args):
        return build(builder, *args)


_define_mask_operator(operator.and_, lambda builder, a, b: builder.and_(a, b))
_define_mask_operator(operator.or_, lambda builder, a, b: builder.or_(a, b))


@type_callable(operator.invert)
def _type_invert(context):
    return lambda a: mask8 if a is mask8 else None


@lower_builtin(operator.invert, Mask8)
def _lower_invert(context, builder, sig, args):
    return builder.not_(args[0])


# ---------------------------------------------------------------------------------------------- memory


@intrinsic
def load8(typing_context, array, index):
    """array[index : index + 8]; no bounds are checked."""
    if not (_is_flat_float32(array) and isinstance(index, types.Integer)):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], index)
        return builder.load(builder.bitcast(pointer, _FLOATS.as_pointer()), align=4)

    return signature(float32x8, array, index), build


@intrinsic
def store8(typing_context, array, index, value):
    """array[index : index + 8] = value; no bounds are checked."""
    if not (_is_flat_float32(array) and isinstance(index, types.Integer) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], index)
        builder.store(args[2], builder.bitcast(pointer, _FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature(types.void, array, index, value), build


@intrinsic
def store_whole8(typing_context, array, index, value):
    """array[index : index + 8] = value truncated to integers, for a flat int32 array; no bounds are checked."""
    if not (_is_flat(array, types.int32) and isinstance(index, types.Integer) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], index)
        builder.store(builder.fptosi(args[2], _INTS), builder.bitcast(pointer, _INTS.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature(types.void, array, index, value), build


@intrinsic
def load1(typing_context, array, index):
    """array[index] without numba's test for a negative index."""
    if not (_is_flat_float32(array) and isinstance(index, types.Integer)):
        return None

    def build(context, builder, sig, args):
        return builder.load(_pointer(context, builder, array, args[0], args[1], index), align=4)

    return signature(types.float32, array, index), build


@intrinsic
def prefetch(typing_context, array, index):
    """Ask for the cache line of array[index]; any index is allowed."""
    if not (_is_flat_float32(array) and isinstance(index, types.Integer)):
        return None

    def build(context, builder, sig, args):
        byte, flag = ir.IntType(8).as_pointer(), ir.IntType(32)
        pointer = builder.bitcast(_pointer(context, builder, array, args[0], args[1], index), byte)
        name = "llvm.prefetch.p0"
        kind = ir.FunctionType(ir.VoidType(), [byte, flag, flag, flag])
        function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        builder.call(function, [pointer, flag(0), flag(3), flag(1)])
        return context.get_dummy_value()

    return signature(types.void, array, index), build


@intrinsic
def gather8(typing_context, array, index, stride):
    """array[index + stride * (0 … 7)]; no bounds are checked."""
    if not (_is_flat_float32(array) and isinstance(index, types.Integer) and isinstance(stride, types.Integer)):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], index)
        step = context.cast(builder, args[2], stride, types.intp)
        vector = ir.Constant(_FLOATS, ir.Undefined)
        for i in range(LANES):
            offset = builder.mul(step, ir.Constant(step.type, i))
            value = builder.load(builder.gep(pointer, [offset], inbounds=True), align=4)
            vector = builder.insert_element(vector, value, _lane(i))
        return vector

    return signature(float32x8, array, index, stride), build


@intrinsic
def scatter8(typing_context, array, index, stride, value):
    """array[index + stride * (0 … 7)] = value; no bounds are checked."""
    if not (_is_flat_float32(array) and isinstance(index, types.Integer) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], index)
        step = context.cast(builder, args[2], stride, types.intp)
        for i in range(LANES):
            offset = builder.mul(step, ir.Constant(step.type, i))
            builder.store(
                builder.extract_element(args[3], _lane(i)), builder.gep(pointer, [offset], inbounds=True), align=4
            )
        return context.get_dummy_value()

    return signature(types.void, array, index, stride, value), build


@intrinsic
def gather_pairs8(typing_context, array, at, index, beyond):
    """(array[k], array[k + 1]) for the eight k = at[index] + beyond, ...; at is flat int32. No bounds are checked."""
    integers = isinstance(index, types.Integer) and isinstance(beyond, types.Integer)
    if not (_is_flat_float32(array) and _is_flat(at, types.int32) and integers):
        return None
    kind = types.UniTuple(float32x8, 2)

    def build(context, builder, sig, args):
        pair = ir.VectorType(_FLOAT, 2)
        places = _pointer(context, builder, at, args[1], args[2], index)
        origin = _pointer(context, builder, array, args[0], args[3], beyond)
        vectors = []
        for i in range(LANES):
            place = builder.load(builder.gep(places, [_lane(i)], inbounds=True), align=4)
            pointer = builder.gep(origin, [builder.sext(place, ir.IntType(64))], inbounds=True)
            vectors.append(builder.load(builder.bitcast(pointer, pair.as_pointer()), align=4))
        while len(vectors) > 2:
            order = range(2 * vectors[0].type.count)
            vectors = [_shuffle(builder, a, b, order) for a, b in zip(vectors[0::2], vectors[1::2], strict=True)]
        low, high = vectors
        return context.make_tuple(
            builder, kind, [_shuffle(builder, low, high, range(start, 2 * LANES, 2)) for start in (0, 1)]
        )

    return signature(kind, array, at, index, beyond), build


# ---------------------------------------------------------------------------------------------- lanes


@intrinsic
def splat8(typing_context, number):
    """The number in all eight lanes."""
    if not _is_number(number):
        return None

    def build(context, builder, sig, args):
        return _as_floats(context, builder, args[0], number)

    return signature(float32x8, number), build


@intrinsic
def lanes8(typing_context):
    """0, 1, … 7."""

    def build(context, builder, sig, args):
        return ir.Constant(_FLOATS, [float(i) for i in range(LANES)])

    return signature(float32x8), build


@intrinsic
def select8(typing_context, mask, yes, no):
    """`yes` in lanes where the mask is true, else `no`; either may be a scalar."""
    if mask is not mask8:
        return None

    def build(context, builder, sig, args):
        a, b = (_as_floats(context, builder, value, kind) for value, kind in ((args[1], yes), (args[2], no)))
        return builder.select(args[0], a, b)

    return signature(float32x8, mask, yes, no), build


@intrinsic
def any8(typing_context, mask):
    """Whether the mask is true in any lane."""
    if mask is not mask8:
        return None

    def build(context, builder, sig, args):
        byte = ir.IntType(LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], byte), ir.Constant(byte, 0))

    return signature(types.boolean, mask), build


@intrinsic
def bits8(typing_context, mask):
    """The mask as an integer; bit i is lane i."""
    if mask is not mask8:
        return None

    def build(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), ir.IntType(64))

    return signature(types.int64, mask), build


@intrinsic
def mask8_of(typing_context, bits):
    """The mask whose lane i is bit i of an integer; the inverse of `bits8`."""
    if not isinstance(bits, types.Integer):
        return None

    def build(context, builder, sig, args):
        low = context.cast(builder, args[0], bits, types.uint8)
        return builder.bitcast(low, _BITS)

    return signature(mask8, bits), build


def _shuffle(builder, a, b, order):
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_INT, len(order)), list(order)))


@intrinsic
def largest8(typing_context, vector):
    """The largest of the eight; none may be NaN."""
    if vector is not float32x8:
        return None

    def build(context, builder, sig, args):
        value = args[0]
        for step in (4, 2, 1):
            turned = _shuffle(builder, value, value, [(i + step) % LANES for i in range(LANES)])
            value = builder.select(builder.fcmp_ordered(">", value, turned), value, turned)
        return builder.extract_element(value, _lane(0))

    return signature(types.float32, vector), build


@intrinsic
def sums8(typing_context, a, b, c, d, e, f, g, h):
    """The sums over the lanes of eight vectors, as one vector."""
    if any(kind is not float32x8 for kind in (a, b, c, d, e, f, g, h)):
        return None
    even = (0, 8, 2, 10, 4, 12, 6, 14)
    odd = (1, 9, 3, 11, 5, 13, 7, 15)
    # After `even + odd` of (a, b): a01 b01 a23 b23 a45 b45 a67 b67, and so on upwards.
    pairs_low, pairs_high = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)
    quads_low, quads_high = (0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)

    def build(context, builder, sig, args):
        vectors = list(args)
        for low, high in ((even, odd), (pairs_low, pairs_high), (quads_low, quads_high)):
            vectors = [
                builder.fadd(_shuffle(builder, x, y, low), _shuffle(builder, x, y, high))
                for x, y in zip(vectors[0::2], vectors[1::2], strict=True)
            ]
        return vectors[0]

    return signature(float32x8, a, b, c, d, e, f, g, h), build


# ---------------------------------------------------------------------------------------------- functions


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
        fraction = builder.fsub(x, whole, flags=_CONTRACT)
        power = _polynomial(builder, fraction, coefficients)
        shift = builder.shl(builder.fptosi(whole, _INTS), ir.Constant(_INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(power, _INTS), shift), _FLOATS)

    return build


def _log2(builder, x):
    """log2(m 2**n) = n + (2 / ln 2) atanh((m - 1) / (m + 1)), m in [sqrt(1/2), sqrt(2))."""
    bits = builder.bitcast(x, _INTS)
    root_half = int(np.float32(np.sqrt(0.5)).view(np.int32))
    start = builder.sub(bits, ir.Constant(_INTS, [root_half] * LANES))
    exponent = builder.ashr(start, ir.Constant(_INTS, [23] * LANES))
    mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, ir.Constant(_INTS, [23] * LANES))), _FLOATS)
    s = builder.fdiv(builder.fsub(mantissa, _constant(1.0)), builder.fadd(mantissa, _constant(1.0)))
    series = _polynomial(builder, builder.fmul(s, s), [2 / np.log(2) / n for n in (1, 3, 5, 7, 9)])
    return builder.fadd(builder.sitofp(exponent, _FLOATS), builder.fmul(s, series), flags=_CONTRACT)


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
        if not _vector_pair(a, b):
            return None

        def build(context, builder, sig, args):
            x, y = (_as_floats(context, builder, value, kind) for value, kind in ((args[0], a), (args[1], b)))
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
        kind = ir.FunctionType(_FLOAT, [_FLOAT])
        function = builder.module.globals.get("llvm.floor.f32") or ir.Function(builder.module, kind, "llvm.floor.f32")
        return builder.fptosi(builder.call(function, args), ir.IntType(64))

    return signature(types.int64, number), build


@njit(forceinline=True)
def exp8(x):
    """exp(x) to 2 units in the last place; 0 below -87, infinity above 88, NaN for NaN."""
    # The reduction in two parts of ln 2 keeps the bits that one product with log2(e) would lose.
    whole = _rint8(x * LOG2_E)
    rest = (x - whole * np.float32(0.693359375)) - whole * np.float32(-2.12194440e-4)
    power = _exp2_8(min8(max8(whole, np.float32(-126.0)), np.float32(126.0))) * _exp2_8(rest * LOG2_E)
    power = select8(x > np.float32(87.0), np.float32(np.inf), power)
    power = select8(x < np.float32(-87.0), np.float32(0.0), power)
    return select8(x == x, power, x)
