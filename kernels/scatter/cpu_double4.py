"""Four float64 lanes as one numba value: three colours and a weight, accumulated together.

`Float64x4` is LLVM's `<4 x double>`; like `Float32x8` of `dofbench.runtime.simd`, for the running sums of the linear
form, which would drift in float32. Values exist only inside compiled functions; `+ - *` work on them.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.core.typing import signature
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable
from numba.np.arrayobj import make_array

from dofbench.runtime.simd import float32x8

_LANES = 4
_DOUBLES = ir.VectorType(ir.DoubleType(), _LANES)
_FLOATS = ir.VectorType(ir.FloatType(), _LANES)
_CONTRACT = ("contract",)


class Float64x4(types.Type):
    """Four float64 numbers."""

    def __init__(self) -> None:
        super().__init__(name="Float64x4")


float64x4 = Float64x4()


@register_model(Float64x4)
class _Float64x4Model(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _DOUBLES)


def _define_binary(op, instruction: str) -> None:
    @type_callable(op)
    def typer_of(context):
        return lambda a, b: float64x4 if a is float64x4 and b is float64x4 else None

    @lower_builtin(op, Float64x4, Float64x4)
    def lower(context, builder, sig, args):
        return getattr(builder, instruction)(*args, flags=_CONTRACT)


_define_binary(operator.add, "fadd")
_define_binary(operator.sub, "fsub")
_define_binary(operator.mul, "fmul")


def _pointer(context, builder, array_type, array, index, kind):
    data = make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index], inbounds=True), kind.as_pointer())


def _splat(builder, number, kind=_DOUBLES):
    empty = ir.Constant(kind, ir.Undefined)
    vector = builder.insert_element(empty, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(vector, empty, ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES))


def _is_flat(array, dtype) -> bool:
    return isinstance(array, types.Array) and array.dtype == dtype and array.layout == "C" and array.ndim == 1


@intrinsic
def load4(typing_context, array, index):
    """array[index : index + 4] of a flat float64 or float32 array, as float64; no bounds are checked."""
    single = _is_flat(array, types.float32)
    if not (single or _is_flat(array, types.float64)):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], _FLOATS if single else _DOUBLES)
        value = builder.load(pointer, align=4 if single else 8)
        return builder.fpext(value, _DOUBLES) if single else value

    return signature(float64x4, array, types.intp), build


@intrinsic
def store4(typing_context, array, index, value):
    """array[index : index + 4] = value for a flat float64 array, or a float32 one, rounded; no bounds are checked."""
    single = _is_flat(array, types.float32)
    if not ((single or _is_flat(array, types.float64)) and value is float64x4):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], _FLOATS if single else _DOUBLES)
        stored = builder.fptrunc(args[2], _FLOATS) if single else args[2]
        builder.store(stored, pointer, align=4 if single else 8)
        return context.get_dummy_value()

    return signature(types.void, array, types.intp, value), build


@intrinsic
def add_row4(typing_context, array, index, value, values, at):
    """array[index : index + 4] += value + values[at : at + 4], flat float32 arrays; no bounds are checked."""
    if not (_is_flat(array, types.float32) and _is_flat(values, types.float32) and value is float64x4):
        return None

    def build(context, builder, sig, args):
        pointer = _pointer(context, builder, array, args[0], args[1], _FLOATS)
        other = builder.load(_pointer(context, builder, values, args[3], args[4], _FLOATS), align=4)
        added = builder.fadd(builder.fptrunc(args[2], _FLOATS), other)
        builder.store(builder.fadd(builder.load(pointer, align=4), added), pointer, align=4)
        return context.get_dummy_value()

    return signature(types.void, array, types.intp, value, values, types.intp), build


@intrinsic
def add_product4(typing_context, array, left, right, weights, at, colours, of):
    """array[left : left + 4] and array[right : right + 4] += weights[at] * colours[of : of + 4].

    All flat float32 arrays, in float32; no bounds are checked. `left` first, so that both may be the same.
    """
    if not all(_is_flat(kind, types.float32) for kind in (array, weights, colours)):
        return None

    def build(context, builder, sig, args):
        sums, left, right, weights_, at_, colours_, of_ = args
        weight = builder.load(_pointer(context, builder, weights, weights_, at_, ir.FloatType()), align=4)
        colour = builder.load(_pointer(context, builder, colours, colours_, of_, _FLOATS), align=4)
        product = builder.fmul(_splat(builder, weight, _FLOATS), colour)
        for place in (left, right):
            pointer = _pointer(context, builder, array, sums, place, _FLOATS)
            builder.store(builder.fadd(builder.load(pointer, align=4), product), pointer, align=4)
        return context.get_dummy_value()

    return signature(types.void, array, types.intp, types.intp, weights, types.intp, colours, types.intp), build


@intrinsic
def store_double8(typing_context, array, index, value):
    """array[index : index + 8] = value, eight float32 lanes, for a flat float64 array; no bounds are checked."""
    if not (_is_flat(array, types.float64) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        eight = ir.VectorType(ir.DoubleType(), 8)
        pointer = _pointer(context, builder, array, args[0], args[1], eight)
        builder.store(builder.fpext(args[2], eight), pointer, align=8)
        return context.get_dummy_value()

    return signature(types.void, array, types.intp, value), build


@intrinsic
def splat_at4(typing_context, array, index):
    """array[index] of a flat float64 array in all four lanes; no bounds are checked."""
    if not _is_flat(array, types.float64):
        return None

    def build(context, builder, sig, args):
        number = builder.load(_pointer(context, builder, array, args[0], args[1], ir.DoubleType()), align=8)
        return _splat(builder, number)

    return signature(float64x4, array, types.intp), build


@intrinsic
def splat4(typing_context, number):
    """The number in all four lanes."""

    def build(context, builder, sig, args):
        return _splat(builder, args[0])

    return signature(float64x4, types.float64), build
