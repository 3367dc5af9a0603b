"""Eight float32 lanes from and to numba's flat arrays, beside each other or apart; no bounds are checked."""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core.typing import signature
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

from .simd import FLOAT, FLOATS, INTS, LANES, float32x8, lane, shuffle


def pointer_to(context, builder, array_type, array, index, index_type):
    """The address of array[index], without numba's test for a negative index."""
    data = make_array(array_type)(context, builder, array).data
    return builder.gep(data, [context.cast(builder, index, index_type, types.intp)], inbounds=True)


def is_flat(array, number) -> bool:
    """Whether a type is that of a flat, contiguous array of this number type."""
    return isinstance(array, types.Array) and array.dtype == number and array.layout == "C" and array.ndim == 1


def is_flat_float32(array) -> bool:
    """Whether a type is that of a flat, contiguous float32 array."""
    return is_flat(array, types.float32)


@intrinsic
def load8(typing_context, array, index):
    """array[index : index + 8]; no bounds are checked."""
    if not (is_flat_float32(array) and isinstance(index, types.Integer)):
        return None

    def build(context, builder, sig, args):
        pointer = pointer_to(context, builder, array, args[0], args[1], index)
        return builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4)

    return signature(float32x8, array, index), build


@intrinsic
def store8(typing_context, array, index, value):
    """array[index : index + 8] = value; no bounds are checked."""
    if not (is_flat_float32(array) and isinstance(index, types.Integer) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        pointer = pointer_to(context, builder, array, args[0], args[1], index)
        builder.store(args[2], builder.bitcast(pointer, FLOATS.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature(types.void, array, index, value), build


@intrinsic
def store_whole8(typing_context, array, index, value):
    """array[index : index + 8] = value truncated to integers, for a flat int32 array; no bounds are checked."""
    if not (is_flat(array, types.int32) and isinstance(index, types.Integer) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        pointer = pointer_to(context, builder, array, args[0], args[1], index)
        builder.store(builder.fptosi(args[2], INTS), builder.bitcast(pointer, INTS.as_pointer()), align=4)
        return context.get_dummy_value()

    return signature(types.void, array, index, value), build


@intrinsic
def load1(typing_context, array, index):
    """array[index] without numba's test for a negative index."""
    if not (is_flat_float32(array) and isinstance(index, types.Integer)):
        return None

    def build(context, builder, sig, args):
        return builder.load(pointer_to(context, builder, array, args[0], args[1], index), align=4)

    return signature(types.float32, array, index), build


@intrinsic
def prefetch(typing_context, array, index):
    """Ask for the cache line of array[index], of a flat array; any index is allowed."""
    flat = isinstance(array, types.Array) and array.layout == "C" and array.ndim == 1
    if not (flat and isinstance(index, types.Integer)):
        return None

    def build(context, builder, sig, args):
        byte, flag = ir.IntType(8).as_pointer(), ir.IntType(32)
        pointer = builder.bitcast(pointer_to(context, builder, array, args[0], args[1], index), byte)
        name = "llvm.prefetch.p0"
        kind = ir.FunctionType(ir.VoidType(), [byte, flag, flag, flag])
        function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        builder.call(function, [pointer, flag(0), flag(3), flag(1)])
        return context.get_dummy_value()

    return signature(types.void, array, index), build


@intrinsic
def gather8(typing_context, array, index, stride):
    """array[index + stride * (0 … 7)]; no bounds are checked."""
    if not (is_flat_float32(array) and isinstance(index, types.Integer) and isinstance(stride, types.Integer)):
        return None

    def build(context, builder, sig, args):
        pointer = pointer_to(context, builder, array, args[0], args[1], index)
        step = context.cast(builder, args[2], stride, types.intp)
        vector = ir.Constant(FLOATS, ir.Undefined)
        for i in range(LANES):
            offset = builder.mul(step, ir.Constant(step.type, i))
            value = builder.load(builder.gep(pointer, [offset], inbounds=True), align=4)
            vector = builder.insert_element(vector, value, lane(i))
        return vector

    return signature(float32x8, array, index, stride), build


@intrinsic
def scatter8(typing_context, array, index, stride, value):
    """array[index + stride * (0 … 7)] = value; no bounds are checked."""
    if not (is_flat_float32(array) and isinstance(index, types.Integer) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        pointer = pointer_to(context, builder, array, args[0], args[1], index)
        step = context.cast(builder, args[2], stride, types.intp)
        for i in range(LANES):
            offset = builder.mul(step, ir.Constant(step.type, i))
            builder.store(
                builder.extract_element(args[3], lane(i)), builder.gep(pointer, [offset], inbounds=True), align=4
            )
        return context.get_dummy_value()

    return signature(types.void, array, index, stride, value), build


@intrinsic
def gather_pairs8(typing_context, array, at, index, beyond):
    """(array[k], array[k + 1]) for the eight k = at[index] + beyond, ...; at is flat int32. No bounds are checked."""
    integers = isinstance(index, types.Integer) and isinstance(beyond, types.Integer)
    if not (is_flat_float32(array) and is_flat(at, types.int32) and integers):
        return None
    kind = types.UniTuple(float32x8, 2)

    def build(context, builder, sig, args):
        pair = ir.VectorType(FLOAT, 2)
        places = pointer_to(context, builder, at, args[1], args[2], index)
        origin = pointer_to(context, builder, array, args[0], args[3], beyond)
        vectors = []
        for i in range(LANES):
            place = builder.load(builder.gep(places, [lane(i)], inbounds=True), align=4)
            pointer = builder.gep(origin, [builder.sext(place, ir.IntType(64))], inbounds=True)
            vectors.append(builder.load(builder.bitcast(pointer, pair.as_pointer()), align=4))
        while len(vectors) > 2:
            order = range(2 * vectors[0].type.count)
            vectors = [shuffle(builder, a, b, order) for a, b in zip(vectors[0::2], vectors[1::2], strict=True)]
        low, high = vectors
        return context.make_tuple(
            builder, kind, [shuffle(builder, low, high, range(start, 2 * LANES, 2)) for start in (0, 1)]
        )

    return signature(kind, array, at, index, beyond), build
