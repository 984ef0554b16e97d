"""Eight single-precision numbers as one value in compiled loops: what a processor's vector registers hold.

Knows vectors and how they are compiled; knows nothing of maps. A compiler finds such vectors in plain loops
only where loops are long; the loops over a few classes or a few samples that a fit is made of run several
times as fast when they are told. Where registers hold four numbers, the compiler takes two of them.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.extending import models, register_model

LANES = 8
"""Numbers in a vector."""
intrinsic: Any = extending.intrinsic
"""What follows a function that builds it is code inside compiled loops; it cannot be called elsewhere."""
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_WHOLE = ir.VectorType(ir.IntType(32), LANES)
_LOG2_E = 1.4426950408889634
_LN2 = 0.693359375, -2.12194440e-4
"""ln 2 in two parts, of which the first times a small whole number is exact (Cody and Waite 1980)."""
_EXP = 1 / 5040, 1 / 720, 1 / 120, 1 / 24, 1 / 6, 0.5, 1.0, 1.0
"""exp on [-ln 2 / 2, ln 2 / 2], highest power first: right to 1e-7 of its value, single precision's limit."""
_HALF_ROOT = 0x3F3504F3
"""Bits of the square root of 1/2."""
_ARTANH = 2 / 11, 2 / 9, 2 / 7, 2 / 5, 2 / 3, 2.0
"""2 artanh(r) / r by powers of r^2, highest first, right to 1e-8 for r up to 0.172."""
_LEAST = -87.0
"""exp below this is not a normal number; it is given as if it were this, 1e-38."""


class _VectorType(types.Type):
    """Type of a vector in compiled loops."""

    def __init__(self) -> None:
        super().__init__(name="eight float32")


_vector = _VectorType()


@register_model(_VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


@intrinsic
def load(context: Any, array: Any, first: Any) -> Any:
    """The vector of array[first : first + 8], of a contiguous float32 array (n,); no bounds are checked."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], *args), align=4)

    return _vector(array, types.intp), generate


@intrinsic
def store(context: Any, array: Any, first: Any, vector: Any) -> Any:
    """Write a vector to array[first : first + 8]; no bounds are checked."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.store(args[2], _address(context, builder, signature.args[0], *args[:2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, _vector), generate


@intrinsic
def every(context: Any, number: Any) -> Any:
    """One number in all places."""
    return _vector(types.float32), lambda context, builder, signature, args: _spread(builder, args[0])


@intrinsic
def every_of(context: Any, array: Any, place: Any) -> Any:
    """array[place] in all places; place >= 0, which is not checked."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return _spread(builder, builder.load(builder.gep(data, [args[1]]), align=4))

    return _vector(array, types.intp), generate


@intrinsic
def plus_product(context: Any, total: Any, a: Any, b: Any) -> Any:
    """total + a b, rounded once where the processor can."""
    return _vector(_vector, _vector, _vector), lambda context, builder, signature, args: _fused(
        builder, args[1], args[2], args[0]
    )


@intrinsic
def plus(context: Any, a: Any, b: Any) -> Any:
    """a + b."""
    return _vector(_vector, _vector), lambda context, builder, signature, args: builder.fadd(*args)


@intrinsic
def minus(context: Any, a: Any, b: Any) -> Any:
    """a - b."""
    return _vector(_vector, _vector), lambda context, builder, signature, args: builder.fsub(*args)


@intrinsic
def times(context: Any, a: Any, b: Any) -> Any:
    """a b."""
    return _vector(_vector, _vector), lambda context, builder, signature, args: builder.fmul(*args)


@intrinsic
def over(context: Any, a: Any, b: Any) -> Any:
    """a / b."""
    return _vector(_vector, _vector), lambda context, builder, signature, args: builder.fdiv(*args)


@intrinsic
def larger(context: Any, a: Any, b: Any) -> Any:
    """The larger of a and b, place by place."""
    return _vector(_vector, _vector), lambda context, builder, signature, args: _larger(builder, *args)


@intrinsic
def above(context: Any, a: Any, least: Any) -> Any:
    """a where it is more than `least`, else 0."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", *args), args[0], _constant(0.0))

    return _vector(_vector, _vector), generate


@intrinsic
def any_above(context: Any, a: Any, least: Any) -> Any:
    """Whether any of the eight numbers is more than `least`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits = builder.bitcast(builder.fcmp_ordered(">", *args), ir.IntType(LANES))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))

    return types.boolean(_vector, _vector), generate


@intrinsic
def lowest_bit(context: Any, bits: Any) -> Any:
    """Place of the lowest bit that is set in an int64 other than 0."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


@intrinsic
def highest(context: Any, a: Any) -> Any:
    """The largest of the eight numbers."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a = args[0]
        for apart in (4, 2, 1):
            places = [(k + apart) % LANES for k in range(LANES)]
            a = _larger(builder, a, builder.shuffle_vector(a, a, ir.Constant(_WHOLE, places)))
        return builder.extract_element(a, ir.Constant(ir.IntType(32), 0))

    return types.float32(_vector), generate


@intrinsic
def sum_of(context: Any, a: Any) -> Any:
    """The sum of the eight numbers."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a = args[0]
        for apart in (4, 2, 1):
            places = [(k + apart) % LANES for k in range(LANES)]
            a = builder.fadd(a, builder.shuffle_vector(a, a, ir.Constant(_WHOLE, places)))
        return builder.extract_element(a, ir.Constant(ir.IntType(32), 0))

    return types.float32(_vector), generate


@intrinsic
def exponential(context: Any, a: Any) -> Any:
    """exp(a) for a at most 88, 1e-38 where it is less."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a = _larger(builder, args[0], _constant(_LEAST))
        power = _call(builder, "llvm.rint", builder.fmul(a, _constant(_LOG2_E)))
        for part in _LN2:
            a = _fused(builder, power, _constant(-part), a)
        value = _constant(_EXP[0])
        for coefficient in _EXP[1:]:
            value = _fused(builder, value, a, _constant(coefficient))
        # 2^n is the number whose exponent's bits are n + 127.
        bits = builder.add(builder.fptosi(power, _WHOLE), ir.Constant(_WHOLE, [127] * LANES))
        scale = builder.bitcast(builder.shl(bits, ir.Constant(_WHOLE, [23] * LANES)), _VECTOR)
        return builder.fmul(value, scale)

    return _vector(_vector), generate


@intrinsic
def logarithm(context: Any, a: Any) -> Any:
    """ln(a) for a more than 1e-38."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], _WHOLE)
        # Mantissas from sqrt(1/2) to sqrt(2): where they begin is taken off before the exponent is read.
        from_half = builder.sub(bits, ir.Constant(_WHOLE, [_HALF_ROOT] * LANES))
        power = builder.ashr(from_half, ir.Constant(_WHOLE, [23] * LANES))
        whole = builder.shl(power, ir.Constant(_WHOLE, [23] * LANES))
        mantissa = builder.bitcast(builder.sub(bits, whole), _VECTOR)
        # ln m = 2 artanh((m - 1) / (m + 1))
        one = _constant(1.0)
        ratio = builder.fdiv(builder.fsub(mantissa, one), builder.fadd(mantissa, one))
        square = builder.fmul(ratio, ratio)
        value = _constant(_ARTANH[0])
        for coefficient in _ARTANH[1:]:
            value = _fused(builder, value, square, _constant(coefficient))
        value = builder.fmul(value, ratio)
        return _fused(builder, builder.sitofp(power, _VECTOR), _constant(sum(_LN2)), value)

    return _vector(_vector), generate


def _address(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [first]), _VECTOR.as_pointer())


def _constant(number: float) -> Any:
    return ir.Constant(_VECTOR, [number] * LANES)


def _spread(builder: Any, number: Any) -> Any:
    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, first, ir.Constant(_WHOLE, [0] * LANES))


def _larger(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _fused(builder: Any, a: Any, b: Any, total: Any) -> Any:
    return _call(builder, "llvm.fmuladd", a, b, total)


def _call(builder: Any, name: str, *args: Any) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(args))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"{name}.v{LANES}f32"), args)
