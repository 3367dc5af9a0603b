"""Eight float32 lanes as one numba value: kernels are vectorised explicitly, whatever the compiler's auto-vectoriser
does.

`Float32x8` is LLVM's `<8 x float>`: one register with AVX, two with SSE or NEON. Values exist only
inside compiled functions. `+ - * /`, unary minus, comparisons (giving a mask) and `& | ~` on masks
work as for numbers; a scalar on either side is broadcast. Multiplications and additions may be
contracted to fused ones; nothing else is reordered, so NaN and infinity behave as IEEE 754 says.
`simd_memory.py` reads and writes such values, `simd_functions.py` computes exponentials and the like of them.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing import signature
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES = 8

FLOAT = ir.FloatType()
INT = ir.IntType(32)
FLOATS = ir.VectorType(FLOAT, LANES)
INTS = ir.VectorType(INT, LANES)
BITS = ir.VectorType(ir.IntType(1), LANES)
CONTRACT = ("contract",)


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
        super().__init__(dmm, fe_type, FLOATS)


@register_model(Mask8)
class _Mask8Model(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, BITS)


# ---------------------------------------------------------------------------------------------- building blocks


def constant(number: float) -> ir.Constant:
    """A number in all eight lanes, known when a kernel is compiled."""
    return ir.Constant(FLOATS, [float(np.float32(number))] * LANES)


def lane(index: int) -> ir.Constant:
    """The index of a lane, as LLVM takes it."""
    return ir.Constant(INT, index)


def _splat(builder, scalar):
    vector = builder.insert_element(ir.Constant(FLOATS, ir.Undefined), scalar, lane(0))
    return builder.shuffle_vector(vector, ir.Constant(FLOATS, ir.Undefined), ir.Constant(INTS, [0] * LANES))


def as_floats(context, builder, value, kind):
    """An operand of the type `kind` as eight lanes; a scalar is put in all of them."""
    if kind is float32x8:
        return value
    return _splat(builder, context.cast(builder, value, kind, types.float32))


def _is_number(kind) -> bool:
    return isinstance(kind, types.Float)


def shuffle(builder, a, b, order):
    """The lanes of a and then of b, chosen by their numbers."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(INT, len(order)), list(order)))


# ---------------------------------------------------------------------------------------------- operators


def vector_pair(a, b) -> bool:
    """Whether two types are those of operands: one has eight lanes, the other has too or is a float."""
    return (a is float32x8 and (b is float32x8 or _is_number(b))) or (b is float32x8 and _is_number(a))


def _define_binary(op, result, build) -> None:
    @type_callable(op)
    def typer_of(context):
        def typer(a, b):
            return result if vector_pair(a, b) else None

        return typer

    def lower(context, builder, sig, args):
        a, b = (as_floats(context, builder, value, kind) for value, kind in zip(args, sig.args, strict=True))
        return build(builder, a, b)

    for pair in ((Float32x8, Float32x8), (Float32x8, types.Float), (types.Float, Float32x8)):
        lower_builtin(op, *pair)(lower)


for _op in (operator.add, operator.iadd):
    _define_binary(_op, float32x8, lambda builder, a, b: builder.fadd(a, b, flags=CONTRACT))
for _op in (operator.sub, operator.isub):
    _define_binary(_op, float32x8, lambda builder, a, b: builder.fsub(a, b, flags=CONTRACT))
for _op in (operator.mul, operator.imul):
    _define_binary(_op, float32x8, lambda builder, a, b: builder.fmul(a, b, flags=CONTRACT))
_define_binary(operator.truediv, float32x8, lambda builder, a, b: builder.fdiv(a, b))
for _symbol, _op in (("<", operator.lt), ("<=", operator.le), (">", operator.gt), (">=", operator.ge)):
    _define_binary(_op, mask8, lambda builder, a, b, s=_symbol: builder.fcmp_ordered(s, a, b))
_define_binary(operator.eq, mask8, lambda builder, a, b: builder.fcmp_ordered("==", a, b))


@type_callable(operator.neg)
def _type_neg(context):
    return lambda a: float32x8 if a is float32x8 else None


@lower_builtin(operator.neg, Float32x8)
def _lower_neg(context, builder, sig, args):
    return builder.fsub(constant(-0.0), args[0])


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


# ---------------------------------------------------------------------------------------------- lanes


@intrinsic
def splat8(typing_context, number):
    """The number in all eight lanes."""
    if not _is_number(number):
        return None

    def build(context, builder, sig, args):
        return as_floats(context, builder, args[0], number)

    return signature(float32x8, number), build


@intrinsic
def lanes8(typing_context):
    """0, 1, … 7."""

    def build(context, builder, sig, args):
        return ir.Constant(FLOATS, [float(i) for i in range(LANES)])

    return signature(float32x8), build


@intrinsic
def select8(typing_context, mask, yes, no):
    """`yes` in lanes where the mask is true, else `no`; either may be a scalar."""
    if mask is not mask8:
        return None

    def build(context, builder, sig, args):
        a, b = (as_floats(context, builder, value, kind) for value, kind in ((args[1], yes), (args[2], no)))
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
        return builder.bitcast(low, BITS)

    return signature(mask8, bits), build


@intrinsic
def largest8(typing_context, vector):
    """The largest of the eight; none may be NaN."""
    if vector is not float32x8:
        return None

    def build(context, builder, sig, args):
        value = args[0]
        for step in (4, 2, 1):
            turned = shuffle(builder, value, value, [(i + step) % LANES for i in range(LANES)])
            value = builder.select(builder.fcmp_ordered(">", value, turned), value, turned)
        return builder.extract_element(value, lane(0))

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
                builder.fadd(shuffle(builder, x, y, low), shuffle(builder, x, y, high))
                for x, y in zip(vectors[0::2], vectors[1::2], strict=True)
            ]
        return vectors[0]

    return signature(float32x8, a, b, c, d, e, f, g, h), build
