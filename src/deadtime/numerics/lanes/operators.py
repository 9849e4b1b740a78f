"""Vectors of eight as numbers: operators, functions, and arrays of them.

A vector with one float per scenario has the operators of a number; a comparison is a vector of
booleans. `lanes_of` views arrays of floats whose last axis is the scenario as arrays of vectors.
The functions of `deadtime.numerics.numbers` are compiled here, also for floats.

Exponentials and logarithms are polynomials, accurate to round-off.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model
from numba.np.arrayobj import populate_array

from deadtime.numerics import numbers
from deadtime.numerics.lanes.code import (
    EIGHT,
    LANES,
    VECTOR,
    WORDS,
    Code,
    KnownNumbersType,
    Lanes,
    same_for_all,
)
from deadtime.numerics.lanes.intrinsics import exponent_of, mantissa_of

_LOG2_E, _LN2_HIGH, _LN2_LOW = (
    1.4426950408889634,
    6.93147180369123816490e-01,
    1.9082149292705877e-10,
)
_SHIFT = 1.5 * 2.0**52  # adding it rounds a number to an integer, in the lowest bits of the sum
_LEAST = -700.0
_FACTORIALS = [1.0]
for _k in range(1, 14):
    _FACTORIALS.append(_FACTORIALS[-1] * _k)


def _all(value: float) -> Any:
    return ir.Constant(VECTOR, [value] * LANES)


def exponential_of(code: Code, a: Any) -> Any:
    """e^a = 2^k e^r for a up to 700, 0 below −700: r the rest of a multiple of ln 2, |r| < 0.35."""
    build = code.builder
    y = code.larger(_all(_LEAST), a)  # NaN propagates
    shifted = code.fma(y, _all(_LOG2_E), _all(_SHIFT))
    k = build.fsub(shifted, _all(_SHIFT))
    r = code.fma(k, _all(-_LN2_LOW), code.fma(k, _all(-_LN2_HIGH), y))
    power = _all(1.0 / _FACTORIALS[-1])
    for factorial in reversed(_FACTORIALS[:-1]):
        power = code.fma(power, r, _all(1.0 / factorial))
    exponent = build.shl(build.bitcast(shifted, WORDS), code.bits(WORDS, 52))
    result = build.bitcast(build.add(build.bitcast(power, WORDS), exponent), VECTOR)
    return build.select(build.fcmp_ordered("<", a, _all(_LEAST)), _all(0.0), result)


def logarithm_of(code: Code, a: Any) -> Any:
    """log a of positive normal numbers or ∞: e ln 2 + 2 artanh s, s = (m − 1)/(m + 1).

    m is the mantissa, halved if it is above √2, so that |s| < 0.172, and artanh has terms to s²³.
    """
    build, m, e = code.builder, mantissa_of(code, a), exponent_of(code, a)
    halve = build.fcmp_ordered(">", m, _all(math.sqrt(2.0)))
    m = build.select(halve, build.fmul(m, _all(0.5)), m)
    e = build.select(halve, build.fadd(e, _all(1.0)), e)
    s = build.fdiv(build.fsub(m, _all(1.0)), build.fadd(m, _all(1.0)))
    square, series = build.fmul(s, s), _all(2.0 / 23.0)
    for odd in range(21, 0, -2):
        series = code.fma(series, square, _all(2.0 / odd))
    low = code.fma(e, _all(_LN2_LOW), build.fmul(series, s))
    result = code.fma(e, _all(_LN2_HIGH), low)
    return build.select(build.fcmp_ordered("<", a, _all(math.inf)), result, a)


# Types of Numba are called to make signatures, and its named tuples are more than it declares.
# pyright: reportCallIssue=false, reportOptionalCall=false, reportGeneralTypeIssues=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false


_TRUTHS = ir.VectorType(ir.IntType(1), LANES)


class _Truths(types.Type):
    def __init__(self) -> None:
        super().__init__(name="EightTruths")

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        return Conversion.safe if other == types.boolean else None


@register_model(_Truths)
class _TruthsModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _TRUTHS)


_EIGHT_TRUTHS = _Truths()


@lower_cast(types.float64, Lanes)
def _widen(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    return same_for_all(builder, VECTOR, value)


@lower_cast(types.BooleanLiteral, _Truths)
@lower_cast(types.boolean, _Truths)
def _widen_truth(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    return same_for_all(builder, _TRUTHS, value)


def _register(functions: Any, work: Callable[..., Any], result: Any, *kinds: Any) -> None:
    """Register work(Code, *values) as functions of compiled code, for arguments of these types."""

    def lowered(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return work(Code(context, builder), *arguments)

    for function in functions if isinstance(functions, tuple) else (functions,):
        fields = {"key": function, "cases": [signature(result, *kinds)]}
        infer_global(function)(type("Operator", (ConcreteTemplate,), fields))
        lower_builtin(function, *kinds)(lowered)


def make_operators() -> None:
    fused = ("contract",)  # to fused multiply-adds, as in `lanes.intrinsics`
    for functions, make in (
        ((operator.add, operator.iadd), lambda c, a, b: c.builder.fadd(a, b, flags=fused)),
        ((operator.sub, operator.isub), lambda c, a, b: c.builder.fsub(a, b, flags=fused)),
        ((operator.mul, operator.imul), lambda c, a, b: c.builder.fmul(a, b, flags=fused)),
        ((operator.truediv, operator.itruediv), lambda c, a, b: c.builder.fdiv(a, b)),
        (max, lambda c, a, b: c.larger(b, a)),
        (min, lambda c, a, b: c.smaller(b, a)),
    ):
        _register(functions, make, EIGHT, EIGHT, EIGHT)
    for function, sign in ((operator.lt, "<"), (operator.gt, ">"), (operator.ge, ">=")):
        _register(function, _compare(sign), _EIGHT_TRUTHS, EIGHT, EIGHT)
    truths = _EIGHT_TRUTHS, _EIGHT_TRUTHS, _EIGHT_TRUTHS
    _register(operator.and_, lambda c, a, b: c.builder.and_(a, b), *truths)
    _register(operator.or_, lambda c, a, b: c.builder.or_(a, b), *truths)
    _register(operator.neg, _negative, EIGHT, EIGHT)
    _register(abs, _size, EIGHT, EIGHT)
    _register(math.isfinite, _finite, _EIGHT_TRUTHS, EIGHT)
    _register(math.exp, exponential_of, EIGHT, EIGHT)
    _register(math.log, logarithm_of, EIGHT, EIGHT)
    for truth, number in ((types.boolean, types.float64), (_EIGHT_TRUTHS, EIGHT)):
        _register(numbers.where, _choose, number, truth, number, number)
        _register(numbers.ratio, _ratio, number, number, number)
        _register(numbers.mantissa, mantissa_of, number, number)
        _register(numbers.exponent, exponent_of, number, number)


def _compare(sign: str) -> Callable[..., Any]:
    return lambda code, a, b: code.builder.fcmp_ordered(sign, a, b)


def _choose(code: Code, condition: Any, a: Any, b: Any) -> Any:
    return code.builder.select(condition, a, b)


def _negative(code: Code, a: Any) -> Any:
    return code.builder.fsub(ir.Constant(VECTOR, [-0.0] * LANES), a)


def _size(code: Code, a: Any) -> Any:
    kind = ir.FunctionType(VECTOR, [VECTOR])
    name = f"llvm.fabs.v{LANES}f64"
    return code.builder.call(code.builder.module.declare_intrinsic(name, fnty=kind), [a])


def _finite(code: Code, a: Any) -> Any:
    return code.builder.fcmp_ordered("<", _size(code, a), ir.Constant(VECTOR, [math.inf] * LANES))


def _ratio(code: Code, a: Any, b: Any) -> Any:
    zero, build = ir.Constant(a.type, None), code.builder
    return build.select(build.fcmp_ordered(">", b, zero), build.fdiv(a, b), zero)


make_operators()


@infer_global(numbers.flat)
class _Flat(AbstractTemplate):
    key = numbers.flat

    def generic(self, args: Any, kws: Any) -> Any:
        (array,) = args
        return signature(types.Array(array.dtype, 1, "C", aligned=array.aligned), array)


@lower_builtin(numbers.flat, types.Array)
def _flattened(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    # NumPy's reshape is a call, as it depends on strides.
    (given,), kind = signature.args, signature.return_type
    source = context.make_array(given)(context, builder, arguments[0])
    size = [source.nitems]
    view = _new_view(context, builder, kind, source, size, [source.itemsize], source.itemsize)
    return impl_ret_borrowed(context, builder, kind, view)


@infer_global(numbers.room_of)
class _Room(AbstractTemplate):
    key = numbers.room_of

    def generic(self, args: Any, kws: Any) -> Any:
        return signature(args[0], *args)


@lower_builtin(numbers.room_of, types.Array, types.Any)
def _room(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    (kind, sizes), given = signature.args, arguments[0]
    if not isinstance(sizes, KnownNumbersType):
        return impl_ret_borrowed(context, builder, kind, given)
    # On the stack, where no other array overlaps it: the compiler keeps entries with constant
    # indices in registers. `cgutils.alloca_once` would fill it with zeros.
    count = sizes.numbers["room"]
    with builder.goto_entry_block():
        room = builder.alloca(ir.ArrayType(VECTOR, count))
    size, step = ir.Constant(ir.IntType(64), count), ir.Constant(ir.IntType(64), 8 * LANES)
    result = context.make_array(kind)(context, builder)
    data = builder.bitcast(room, result.data.type)
    parts = {"shape": [size], "strides": [step], "itemsize": step, "meminfo": None}
    populate_array(result, data=data, **parts)
    return result._getvalue()


@intrinsic
def lanes_of(_, arrays):
    """Arrays (…, 8) of floats, also in a named tuple, as arrays of vectors, without a copy."""
    kind = _kind_of(arrays)

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = _view(context, builder, arrays, kind, arguments[0])
        return impl_ret_borrowed(context, builder, kind, view)

    return kind(arrays), code


def _kind_of(given: Any) -> Any:
    if isinstance(given, types.BaseNamedTuple):
        kinds = [_kind_of(part) for part in given]
        return types.BaseTuple.from_types(kinds, given.instance_class)
    if isinstance(given, types.Array) and given.dtype == types.float64:
        # Not aligned, because vectors of eight would be assumed to be aligned to a cache line.
        return types.Array(EIGHT, given.ndim - 1, "C", aligned=False)
    return given


def _view(context: Any, builder: Any, given: Any, kind: Any, value: Any) -> Any:
    if given == kind:
        return value
    if isinstance(given, types.BaseNamedTuple):
        parts = cgutils.unpack_tuple(builder, value, len(given))
        views = [_view(context, builder, *each) for each in zip(given, kind, parts, strict=True)]
        return context.make_tuple(builder, kind, views)
    source = context.make_array(given)(context, builder, value)
    shape, strides = (
        cgutils.unpack_tuple(builder, part)[:-1] for part in (source.shape, source.strides)
    )
    size = ir.Constant(ir.IntType(64), 8 * LANES)
    return _new_view(context, builder, kind, source, shape, strides, size)


def _new_view(
    context: Any, builder: Any, kind: Any, source: Any, shape: Any, strides: Any, itemsize: Any
) -> Any:
    """Another array with the data of `source`."""
    result = context.make_array(kind)(context, builder)
    populate_array(
        result,
        data=builder.bitcast(source.data, result.data.type),
        shape=shape,
        strides=strides,
        itemsize=itemsize,
        meminfo=source.meminfo,
        parent=source.parent,
    )
    return result._getvalue()
