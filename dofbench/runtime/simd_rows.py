"""Eight rows of a flat array at once: a row's neighbouring numbers become eight vectors with a lane for each row.

Eight loads of eight numbers and a transposition take a quarter of the instructions of 64 single loads. The rows lie
one after another (`index`, `stride`), or where a flat int32 array says (`rows`, eight numbers of rows of `width`).
No bounds are checked.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core.typing import signature
from numba.extending import intrinsic

from .simd import FLOAT, FLOATS, LANES, float32x8, lane, shuffle
from .simd_memory import is_flat, is_flat_float32, pointer_to

EIGHT = types.UniTuple(float32x8, LANES)
_ZIP_LOW, _ZIP_HIGH = (0, 8, 1, 9, 4, 12, 5, 13), (2, 10, 3, 11, 6, 14, 7, 15)
_PAIRS_LOW, _PAIRS_HIGH = (0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15)
_HALVES_LOW, _HALVES_HIGH = (0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15)


def _transposed(builder, rows):
    """Lane r of vector k becomes lane k of vector r."""

    def both(a, b, low, high):
        return shuffle(builder, a, b, low), shuffle(builder, a, b, high)

    pairs = [both(rows[k], rows[k + 1], _ZIP_LOW, _ZIP_HIGH) for k in range(0, LANES, 2)]
    quads = []
    for first in (0, 2):
        for a, b in zip(pairs[first], pairs[first + 1], strict=True):
            quads += both(a, b, _PAIRS_LOW, _PAIRS_HIGH)
    whole = [both(quads[k], quads[k + 4], _HALVES_LOW, _HALVES_HIGH) for k in range(4)]
    return [low for low, _ in whole] + [high for _, high in whole]


def _load(builder, pointer):
    return builder.load(builder.bitcast(pointer, FLOATS.as_pointer()), align=4)


def _store(builder, vector, pointer):
    builder.store(vector, builder.bitcast(pointer, FLOATS.as_pointer()), align=4)


def _regular(context, builder, sig, args):
    """Pointers to the eight rows of (array, index, stride)."""
    origin = pointer_to(context, builder, sig.args[0], args[0], args[1], sig.args[1])
    step = context.cast(builder, args[2], sig.args[2], types.intp)
    return [builder.gep(origin, [builder.mul(step, ir.Constant(step.type, i))], inbounds=True) for i in range(LANES)]


def _listed(context, builder, sig, args):
    """Pointers to the eight rows of (array, rows, width, column)."""
    origin = pointer_to(context, builder, sig.args[0], args[0], args[3], sig.args[3])
    listed = pointer_to(context, builder, sig.args[1], args[1], ir.Constant(ir.IntType(64), 0), types.intp)
    width = context.cast(builder, args[2], sig.args[2], types.intp)
    pointers = []
    for i in range(LANES):
        number = builder.sext(builder.load(builder.gep(listed, [lane(i)], inbounds=True), align=4), width.type)
        pointers.append(builder.gep(origin, [builder.mul(number, width)], inbounds=True))
    return pointers


def _is_regular(array, *numbers) -> bool:
    return is_flat_float32(array) and all(isinstance(number, types.Integer) for number in numbers)


def _is_listed(array, rows, *numbers) -> bool:
    return _is_regular(array, *numbers) and is_flat(rows, types.int32)


@intrinsic
def load_rows8(typing_context, array, index, stride):
    """Eight vectors: lane r of number k is array[index + stride r + k]."""
    if not _is_regular(array, index, stride):
        return None

    def build(context, builder, sig, args):
        rows = [_load(builder, pointer) for pointer in _regular(context, builder, sig, args)]
        return context.make_tuple(builder, EIGHT, _transposed(builder, rows))

    return signature(EIGHT, array, index, stride), build


@intrinsic
def store_rows8(typing_context, array, index, stride, columns):
    """array[index + stride r + k] = lane r of number k of the eight vectors."""
    if not (_is_regular(array, index, stride) and columns == EIGHT):
        return None

    def build(context, builder, sig, args):
        rows = _transposed(builder, [builder.extract_value(args[3], i) for i in range(LANES)])
        for row, pointer in zip(rows, _regular(context, builder, sig, args), strict=True):
            _store(builder, row, pointer)
        return context.get_dummy_value()

    return signature(types.void, array, index, stride, columns), build


@intrinsic
def load_rows8_at(typing_context, array, rows, width, column):
    """Eight vectors: lane r of number k is array[rows[r] width + column + k]."""
    if not _is_listed(array, rows, width, column):
        return None

    def build(context, builder, sig, args):
        found = [_load(builder, pointer) for pointer in _listed(context, builder, sig, args)]
        return context.make_tuple(builder, EIGHT, _transposed(builder, found))

    return signature(EIGHT, array, rows, width, column), build


@intrinsic
def store_rows8_at(typing_context, array, rows, width, column, columns):
    """array[rows[r] width + column + k] = lane r of number k of the eight vectors."""
    if not (_is_listed(array, rows, width, column) and columns == EIGHT):
        return None

    def build(context, builder, sig, args):
        turned = _transposed(builder, [builder.extract_value(args[4], i) for i in range(LANES)])
        for row, pointer in zip(turned, _listed(context, builder, sig, args), strict=True):
            _store(builder, row, pointer)
        return context.get_dummy_value()

    return signature(types.void, array, rows, width, column, columns), build


@intrinsic
def gather8_at(typing_context, array, rows, width, column):
    """array[rows[0 … 7] width + column]."""
    if not _is_listed(array, rows, width, column):
        return None

    def build(context, builder, sig, args):
        vector = ir.Constant(FLOATS, ir.Undefined)
        for i, pointer in enumerate(_listed(context, builder, sig, args)):
            vector = builder.insert_element(vector, builder.load(pointer, align=4), lane(i))
        return vector

    return signature(float32x8, array, rows, width, column), build


@intrinsic
def scatter8_at(typing_context, array, rows, width, column, value):
    """array[rows[0 … 7] width + column] = value."""
    if not (_is_listed(array, rows, width, column) and value is float32x8):
        return None

    def build(context, builder, sig, args):
        for i, pointer in enumerate(_listed(context, builder, sig, args)):
            builder.store(builder.extract_element(args[4], lane(i)), pointer, align=4)
        return context.get_dummy_value()

    return signature(types.void, array, rows, width, column, value), build


def _dense(width: int, doc: str):
    """A load of eight dense rows of `width` numbers."""
    kind = types.UniTuple(float32x8, width)

    def function(typing_context, array, index):
        if not _is_regular(array, index):
            return None

        def build(context, builder, sig, args):
            whole = ir.VectorType(FLOAT, LANES * width)
            pointer = pointer_to(context, builder, array, args[0], args[1], index)
            block = builder.load(builder.bitcast(pointer, whole.as_pointer()), align=4)
            columns = [shuffle(builder, block, block, range(k, LANES * width, width)) for k in range(width)]
            return context.make_tuple(builder, kind, columns)

        return signature(kind, array, index), build

    function.__name__, function.__doc__ = f"load_dense{width}", doc
    return intrinsic(function)


load_threes8 = _dense(3, "Three vectors: lane r of number k is array[index + 3 r + k].")
load_fours8 = _dense(4, "Four vectors: lane r of number k is array[index + 4 r + k].")
