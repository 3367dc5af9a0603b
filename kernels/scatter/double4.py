"""Four float64 lanes as one numba value: three colours and a weight, accumulated together.

`Float64x4` is LLVM's `<4 x double>`; as `dofbench.simd`, but for the running sums of the linear form,
which float32 would let drift. Values exist only inside compiled functions; `+ - *` work on them.
"""

from __future__ import annotations

import operator

from llvmlite import ir
from numba import types
from numba.core.typing import signature
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable
from numba.np.arrayobj import make_array

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
def splat4(typing_context, number):
    """The number in all four lanes."""

    def build(context, builder, sig, args):
        empty = ir.Constant(_DOUBLES, ir.Undefined)
        vector = builder.insert_element(empty, args[0], ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(vector, empty, ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES))

    return signature(float64x4, types.float64), build
