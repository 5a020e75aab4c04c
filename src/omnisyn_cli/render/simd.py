"""Eight numbers as one value in a kernel, for loops that the compiler cannot vectorise by itself.

A rasteriser's inner loop is short, conditional and writes where it reads; compilers leave such loops scalar. Here one
value holds eight neighbouring pixels or quads, which LLVM maps to the vectors of the processor. Vectors are of float32,
float64 or int32; ``+``, ``-``, ``*``, ``/`` take two of one kind of floats. A product and a sum become one instruction
where there is one. Comparisons give masks for :func:`where`. No access checks bounds. After a change here the compiled
kernels of other modules are stale: delete ``__pycache__``.

Four texels of four channels are one value of sixteen numbers, float32 or, where samples have 8 bits, integers of 16:
the rounding of such a sum of products is a fiftieth of a level, and it takes half the time.

Pointers carry the type that they point to here, as in llvmlite up to the version that ``pyproject.toml`` ends at. With
opaque pointers alone only :func:`_address` and :func:`_load` change: the cast goes, ``gep`` is told the element's type
(that of ``array.dtype``, no ``pointee``) and loads are told theirs (``typ=``); stores take it from what is stored.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.ir import instructions  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, register_model

LANES = 8  # numbers in a vector
_HALF_LANES = LANES // 2  # numbers in half a vector
FIXED_POINT_UNIT, FIXED_TEXEL = 32767, 1 << 7  # fixed point: the weight 1, and the factor of texels of 8 bits


class _Vector(types.Type):  # type: ignore[misc]
    """Numba's type of a vector; its name tells the element type."""


_float32x8, _float64x8, _int32x8, _mask8 = map(_Vector, ("float32x8", "float64x8", "int32x8", "mask8"))
_float32x16, _int16x16 = map(_Vector, ("float32x16", "int16x16"))
_TYPES = {
    _float32x8: ir.VectorType(ir.FloatType(), LANES), _float64x8: ir.VectorType(ir.DoubleType(), LANES),
    _int32x8: ir.VectorType(ir.IntType(32), LANES), _mask8: ir.VectorType(ir.IntType(1), LANES),
    _float32x16: ir.VectorType(ir.FloatType(), 2 * LANES), _int16x16: ir.VectorType(ir.IntType(16), 2 * LANES),
}  # fmt: skip
_VECTOR_OF = {types.float32: _float32x8, types.float64: _float64x8, types.int32: _int32x8}
_SIXTEEN_OF = {types.float32: _float32x16, types.int16: _int16x16, types.int32: _int16x16}


@register_model(_Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, vector: _Vector) -> None:
        super().__init__(manager, vector, _TYPES[vector])


def _made(build: Callable[..., Any]) -> Callable[..., Any]:
    """What numba calls to make the instructions that ``build`` makes, of a context, a builder and the arguments."""
    return lambda context, builder, signature_, arguments: build(context, builder, *arguments)


def _define(function: Any, build: Any, operands: tuple[_Vector, ...], result: _Vector | None = None) -> None:
    """A binary operator on vectors: its types for numba and the instruction that it is."""
    cases = [signature(result or operand, operand, operand) for operand in operands]
    infer_global(function)(type(f"_{function.__name__}", (ConcreteTemplate,), {"cases": cases}))

    for operand in operands:
        lower_builtin(function, operand, operand)(_made(lambda _, *given: build(*given)))


def _high_half(builder: Any, a: Any, b: Any) -> Any:
    """The upper 16 bits of products of 32."""
    wide = ir.VectorType(ir.IntType(32), 2 * LANES)
    product = builder.mul(builder.sext(a, wide), builder.sext(b, wide))
    return builder.trunc(builder.lshr(product, ir.Constant(wide, [16] * (2 * LANES))), a.type)


_floats = (_float32x8, _float64x8)
_contract = ("contract",)
_define(operator.add, lambda builder, a, b: builder.fadd(a, b, flags=_contract), (*_floats, _float32x16))
_define(operator.sub, lambda builder, a, b: builder.fsub(a, b, flags=_contract), _floats)
_define(operator.mul, lambda builder, a, b: builder.fmul(a, b, flags=_contract), (*_floats, _float32x16))
_define(operator.add, lambda builder, a, b: builder.add(a, b), (_int16x16,))
_define(operator.mul, _high_half, (_int16x16,))
_define(operator.truediv, lambda builder, a, b: builder.fdiv(a, b), _floats)
_define(operator.ge, lambda builder, a, b: builder.fcmp_ordered(">=", a, b), _floats, _mask8)
_define(operator.gt, lambda builder, a, b: builder.fcmp_ordered(">", a, b), _floats, _mask8)
_define(operator.and_, lambda builder, a, b: builder.and_(a, b), (_mask8,))
_define(operator.or_, lambda builder, a, b: builder.or_(a, b), (_mask8,))


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """The eight numbers of a contiguous one-dimensional array from ``index`` on; bounds are not checked."""
    result = _VECTOR_OF[array.dtype](array, types.intp)
    return result, _made(lambda context, builder, *given: _load(context, builder, array, *given))


class _WholeStore(instructions.StoreInstr):  # type: ignore[misc]
    """A volatile store, which LLVM leaves whole: a masked one costs some processors forty times as much."""

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
def broadcast(typing_context: Any, number: Any) -> Any:
    """One number in all eight lanes."""
    return _VECTOR_OF[number](number), _made(lambda _, builder, number: _broadcast(builder, number, LANES))


@intrinsic
def pair(typing_context: Any, first: Any, second: Any) -> Any:
    """One float32 in the lower four places, another in the upper four."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        lower, upper = (_broadcast(builder, argument, _HALF_LANES) for argument in arguments)
        return builder.shuffle_vector(lower, upper, _shuffle_mask(range(LANES)))

    return _float32x8(types.float32, types.float32), generate


@intrinsic
def where(typing_context: Any, mask: Any, first: Any, second: Any) -> Any:
    """``first`` where the mask is set, else ``second``."""
    return first(mask, first, second), _made(lambda _, builder, *arguments: builder.select(*arguments))


@intrinsic
def to_float64(typing_context: Any, vector: Any) -> Any:
    """A float32 vector in float64."""
    return _float64x8(_float32x8), _made(lambda _, builder, numbers: builder.fpext(numbers, _TYPES[_float64x8]))


@intrinsic
def to_float32(typing_context: Any, vector: Any) -> Any:
    """A float64 vector rounded to float32."""
    return _float32x8(_float64x8), _made(lambda _, builder, numbers: builder.fptrunc(numbers, _TYPES[_float32x8]))


@intrinsic
def has_bits(typing_context: Any, array: Any, index: Any, bits: Any) -> Any:
    """A mask of which of eight bytes of a contiguous one-dimensional array have at least one of ``bits`` set."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        flags = _load(context, builder, array, arguments[0], arguments[1])
        common = builder.and_(flags, _broadcast(builder, arguments[2], LANES))
        return builder.icmp_unsigned("!=", common, ir.Constant(common.type, None))

    return _mask8(array, types.intp, types.uint8), generate


@intrinsic
def load_halves(typing_context: Any, array: Any, lower: Any, upper: Any) -> Any:
    """Four numbers from index ``lower`` on and four from ``upper`` on."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        halves = [_load(context, builder, array, arguments[0], index, _HALF_LANES) for index in arguments[1:]]
        return builder.shuffle_vector(*halves, _shuffle_mask(range(LANES)))

    return _VECTOR_OF[array.dtype](array, types.intp, types.intp), generate


@intrinsic
def store_halves(typing_context: Any, array: Any, lower: Any, upper: Any, vector: Any) -> Any:
    """Write the lower four numbers from index ``lower`` on and the upper four from ``upper`` on."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        for half, index in enumerate(arguments[1:3]):
            numbers = builder.shuffle_vector(
                arguments[3], arguments[3], _shuffle_mask(range(_HALF_LANES * half, _HALF_LANES * (half + 1)))
            )
            _store_whole(builder, numbers, _address(context, builder, array, arguments[0], index, _HALF_LANES))
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, vector), generate


@intrinsic
def prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Prefetch the cache line of an element that will be read soon; bounds do not matter."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        place = builder.gep(context.make_array(array)(context, builder, arguments[0]).data, [arguments[1]])
        pointer, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        builder.call(prefetch, [builder.bitcast(place, pointer), *map(cgutils.int32_t, (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


@intrinsic
def load_texels(typing_context: Any, array: Any, index: Any) -> Any:
    """Four texels side by side, the first of which begins at ``index``."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        return _as_texels(builder, _load(context, builder, array, arguments[0], arguments[1], 2 * LANES))

    return _texels_of(array)(array, types.intp), generate


@intrinsic
def load_texel_pairs(typing_context: Any, array: Any, first: Any, second: Any) -> Any:
    """Two texels side by side that begin at ``first``, and two at ``second``."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        pairs = [_load(context, builder, array, arguments[0], index) for index in arguments[1:]]
        return _as_texels(builder, builder.shuffle_vector(*pairs, _shuffle_mask(range(2 * LANES))))

    return _texels_of(array)(array, types.intp, types.intp), generate


@intrinsic
def broadcast_weight(typing_context: Any, weights: Any, index: Any) -> Any:
    """One weight for four texels. Fixed-point weights come twice in 32 bits, because broadcasting 32 bits is free."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        address = builder.gep(context.make_array(weights)(context, builder, arguments[0]).data, [arguments[1]])
        number, vector = builder.load(address), _SIXTEEN_OF[weights.dtype]
        count = LANES if weights.dtype == types.int32 else 2 * LANES
        return builder.bitcast(_broadcast(builder, number, count), _TYPES[vector])

    return _SIXTEEN_OF[weights.dtype](weights, types.intp), generate


@intrinsic
def load_four_weights(typing_context: Any, weights: Any, index: Any) -> Any:
    """Four weights from ``index`` on, each for one of four texels."""

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        four = _load(context, builder, weights, arguments[0], arguments[1], 4)
        return builder.shuffle_vector(four, four, _shuffle_mask([k // 4 for k in range(2 * LANES)]))

    return _SIXTEEN_OF[weights.dtype](weights, types.intp), generate


@intrinsic
def store_texel_sum(typing_context: Any, array: Any, index: Any, texels: Any, scale: Any, shift: Any, last: Any) -> Any:
    """Write the sum of four weighted texels, times ``scale``; three channels plus ``shift``, the fourth times ``last``.

    The array is of float32.
    """

    def generate(context: Any, builder: Any, signature_: Any, arguments: Any) -> Any:
        out, place, total, scale, shift, last = arguments
        add = builder.add if texels == _int16x16 else builder.fadd
        for count in (LANES, _HALF_LANES):
            lower, upper = (_shuffle_mask(range(begin, begin + count)) for begin in (0, count))
            total = add(builder.shuffle_vector(total, total, lower), builder.shuffle_vector(total, total, upper))
        if texels == _int16x16:
            total = builder.sitofp(total, ir.VectorType(ir.FloatType(), _HALF_LANES))
        scales, shifts = _broadcast(builder, scale, _HALF_LANES), _broadcast(builder, shift, _HALF_LANES)
        alpha = cgutils.int32_t(3)
        scales = builder.insert_element(scales, builder.fmul(scale, last), alpha)
        shifts = builder.insert_element(shifts, ir.Constant(ir.FloatType(), 0.0), alpha)
        total = builder.fadd(builder.fmul(total, scales, flags=_contract), shifts, flags=_contract)
        builder.store(total, _address(context, builder, array, out, place, _HALF_LANES), align=4)
        return context.get_dummy_value()

    number = types.float32
    return types.void(array, types.intp, texels, number, number, number), generate


def _texels_of(array: Any) -> _Vector:
    """The type of sixteen numbers of a texture."""
    return _int16x16 if array.dtype == types.uint8 else _float32x16


def _as_texels(builder: Any, vector: Any) -> Any:
    """Sixteen numbers of a texture: samples as integers, so much larger that a product keeps 64 parts of one."""
    if vector.type.element != ir.IntType(8):
        return vector
    wide = ir.VectorType(ir.IntType(16), 2 * LANES)
    return builder.mul(builder.zext(vector, wide), ir.Constant(wide, [FIXED_TEXEL] * (2 * LANES)))


def _address(context: Any, builder: Any, array: Any, argument: Any, index: Any, count: int = LANES) -> Any:
    """A pointer to the ``count`` numbers of an array that begin at an element."""
    element = builder.gep(context.make_array(array)(context, builder, argument).data, [index])
    return builder.bitcast(element, ir.VectorType(element.type.pointee, count).as_pointer())


def _load(context: Any, builder: Any, array: Any, argument: Any, index: Any, count: int = LANES) -> Any:
    """A vector of ``count`` numbers."""
    return builder.load(_address(context, builder, array, argument, index, count), align=array.dtype.bitwidth // 8)


def _broadcast(builder: Any, number: Any, count: int) -> Any:
    undefined = ir.Constant(ir.VectorType(number.type, count), ir.Undefined)
    one = builder.insert_element(undefined, number, cgutils.int32_t(0))
    return builder.shuffle_vector(one, undefined, _shuffle_mask([0] * count))


def _shuffle_mask(places: Any) -> ir.Constant:
    places = list(places)
    return ir.Constant(ir.VectorType(ir.IntType(32), len(places)), places)
