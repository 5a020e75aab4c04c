"""Eight numbers as one value in a kernel, for loops that the compiler cannot vectorise by itself.

A rasteriser's inner loop is short, conditional and writes where it reads; compilers leave such loops scalar. Here one
value holds eight neighbouring pixels or quads, or two texels of four channels, and LLVM makes of it whatever the
processor has. Vectors are of float32, float64 or int32; ``+``, ``-``, ``*``, ``/`` take two of one kind of floats. A
product and a sum become one instruction where there is one. Comparisons give masks for :func:`where`. No access checks
bounds. After a change here the compiled kernels of other modules are stale: delete ``__pycache__``.

Pointers carry the type that they point to here, as in llvmlite up to the version that ``pyproject.toml`` ends at. With
opaque pointers alone only :func:`_address` and :func:`_load` change: the cast goes, ``gep`` is told the element's type
(that of ``array.dtype``, no ``pointee``) and loads are told theirs (``typ=``); stores take it from what is stored.
"""

import operator
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.ir import instructions  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, register_model

LANES = 8
"""Numbers in a vector."""

_HALF = LANES // 2


class _Vector(types.Type):  # type: ignore[misc]
    """Numba's type of a vector; its name tells the element type."""


_float32x8, _float64x8, _int32x8, _mask8 = map(_Vector, ("float32x8", "float64x8", "int32x8", "mask8"))
_ELEMENTS = {
    _float32x8: ir.FloatType(), _float64x8: ir.DoubleType(), _int32x8: ir.IntType(32), _mask8: ir.IntType(1)
}  # fmt: skip
_VECTOR_OF = {types.float32: _float32x8, types.float64: _float64x8, types.int32: _int32x8}


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: _Vector) -> None:
        super().__init__(manager, vector, ir.VectorType(_ELEMENTS[vector], LANES))


def _define(function: Any, build: Any, operands: tuple[_Vector, ...], result: _Vector | None = None) -> None:
    """A binary operator on vectors: its types for numba and the instruction that it is."""
    cases = [signature(result or operand, operand, operand) for operand in operands]
    infer_global(function)(type(f"_{function.__name__}", (ConcreteTemplate,), {"cases": cases}))

    def lower(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return build(builder, *arguments)

    for operand in operands:
        lower_builtin(function, operand, operand)(lower)


_floats = (_float32x8, _float64x8)
_contract = ("contract",)
_define(operator.add, lambda builder, a, b: builder.fadd(a, b, flags=_contract), _floats)
_define(operator.sub, lambda builder, a, b: builder.fsub(a, b, flags=_contract), _floats)
_define(operator.mul, lambda builder, a, b: builder.fmul(a, b, flags=_contract), _floats)
_define(operator.truediv, lambda builder, a, b: builder.fdiv(a, b), _floats)
_define(operator.ge, lambda builder, a, b: builder.fcmp_ordered(">=", a, b), _floats, _mask8)
_define(operator.gt, lambda builder, a, b: builder.fcmp_ordered(">", a, b), _floats, _mask8)
_define(operator.and_, lambda builder, a, b: builder.and_(a, b), (_mask8,))
_define(operator.or_, lambda builder, a, b: builder.or_(a, b), (_mask8,))


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """The eight numbers of a contiguous one-dimensional array from ``index`` on; bounds are not checked.

    Samples of 8 bits become float32.
    """
    samples = array.dtype == types.uint8

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        vector = _load(context, builder, array, arguments[0], arguments[1])
        return builder.uitofp(vector, context.get_value_type(_float32x8)) if samples else vector

    return (_float32x8 if samples else _VECTOR_OF[array.dtype])(array, types.intp), generate


class _WholeStore(instructions.StoreInstr):  # type: ignore[misc]
    """A store that stays one.

    LLVM makes a masked store of "load, choose, store", which costs some processors forty times as much, unless the
    store is volatile.
    """

    def descr(self, buffer: list[str]) -> None:
        text: list[str] = []
        super().descr(text)
        buffer.append("".join(text).replace("store ", "store volatile ", 1))


def _store_whole(builder: Any, vector: Any, address: Any) -> None:
    instruction = _WholeStore(builder.block, vector, address)
    instruction.align = 4
    builder._insert(instruction)


@intrinsic
def store(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write eight numbers into a contiguous one-dimensional array from ``index`` on; bounds are not checked."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        _store_whole(builder, arguments[2], _address(context, builder, array, arguments[0], arguments[1]))
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


@intrinsic
def splat(typing_context: Any, number: Any) -> Any:
    """One number eight times."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return _repeated(builder, arguments[0], LANES)

    return _VECTOR_OF[number](number), generate


@intrinsic
def pair(typing_context: Any, first: Any, second: Any) -> Any:
    """One float32 in the lower four places, another in the upper four."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        lower, upper = (_repeated(builder, argument, _HALF) for argument in arguments)
        return builder.shuffle_vector(lower, upper, _mask_of(range(LANES)))

    return _float32x8(types.float32, types.float32), generate


@intrinsic
def where(typing_context: Any, mask: Any, first: Any, second: Any) -> Any:
    """``first`` where the mask is set, else ``second``."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return first(mask, first, second), generate


@intrinsic
def swapped(typing_context: Any, vector: Any) -> Any:
    """The upper four numbers before the lower four."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return builder.shuffle_vector(arguments[0], arguments[0], _mask_of([4, 5, 6, 7, 0, 1, 2, 3]))

    return vector(vector), generate


@intrinsic
def fourth_times(typing_context: Any, vector: Any, factor: Any) -> Any:
    """The same numbers, but the fourth of them multiplied."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        place = cgutils.int32_t(3)
        product = builder.fmul(builder.extract_element(arguments[0], place), arguments[1])
        return builder.insert_element(arguments[0], product, place)

    return _float32x8(_float32x8, types.float32), generate


@intrinsic
def double(typing_context: Any, vector: Any) -> Any:
    """A float32 vector in float64."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return builder.fpext(arguments[0], context.get_value_type(_float64x8))

    return _float64x8(_float32x8), generate


@intrinsic
def single(typing_context: Any, vector: Any) -> Any:
    """A float64 vector rounded to float32."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return builder.fptrunc(arguments[0], context.get_value_type(_float32x8))

    return _float32x8(_float64x8), generate


@intrinsic
def has_bits(typing_context: Any, array: Any, index: Any, bits: Any) -> Any:
    """A mask of which of eight bytes of a contiguous one-dimensional array have at least one of ``bits`` set."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        flags = _load(context, builder, array, arguments[0], arguments[1])
        common = builder.and_(flags, _repeated(builder, arguments[2], LANES))
        return builder.icmp_unsigned("!=", common, ir.Constant(common.type, None))

    return _mask8(array, types.intp, types.uint8), generate


@intrinsic
def load_halves(typing_context: Any, array: Any, lower: Any, upper: Any) -> Any:
    """Four numbers from index ``lower`` on and four from ``upper`` on."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        halves = [_load(context, builder, array, arguments[0], index, _HALF) for index in arguments[1:]]
        return builder.shuffle_vector(*halves, _mask_of(range(LANES)))

    return _VECTOR_OF[array.dtype](array, types.intp, types.intp), generate


@intrinsic
def store_half(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write the lower four numbers from ``index`` on."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        lower = builder.shuffle_vector(arguments[2], arguments[2], _mask_of(range(_HALF)))
        builder.store(lower, _address(context, builder, array, arguments[0], arguments[1], _HALF), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


@intrinsic
def store_halves(typing_context: Any, array: Any, lower: Any, upper: Any, vector: Any) -> Any:
    """Write the lower four numbers from index ``lower`` on and the upper four from ``upper`` on."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        for half, index in enumerate(arguments[1:3]):
            numbers = builder.shuffle_vector(
                arguments[3], arguments[3], _mask_of(range(_HALF * half, _HALF * (half + 1)))
            )
            _store_whole(builder, numbers, _address(context, builder, array, arguments[0], index, _HALF))
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, vector), generate


def _address(context: Any, builder: Any, array: Any, argument: Any, index: Any, count: int = LANES) -> Any:
    """A pointer to the ``count`` numbers of an array that begin at an element."""
    element = builder.gep(context.make_array(array)(context, builder, argument).data, [index])
    return builder.bitcast(element, ir.VectorType(element.type.pointee, count).as_pointer())


def _load(context: Any, builder: Any, array: Any, argument: Any, index: Any, count: int = LANES) -> Any:
    """These numbers."""
    return builder.load(_address(context, builder, array, argument, index, count), align=array.dtype.bitwidth // 8)


def _repeated(builder: Any, number: Any, count: int) -> Any:
    undefined = ir.Constant(ir.VectorType(number.type, count), ir.Undefined)
    one = builder.insert_element(undefined, number, cgutils.int32_t(0))
    return builder.shuffle_vector(one, undefined, _mask_of([0] * count))


def _mask_of(places: Any) -> ir.Constant:
    places = list(places)
    return ir.Constant(ir.VectorType(ir.IntType(32), len(places)), places)
