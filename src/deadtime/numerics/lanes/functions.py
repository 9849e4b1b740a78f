"""Quotients, roots and exponentials of vectors."""

# Types of Numba are called to make signatures.
# pyright: reportCallIssue=false

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.extending import intrinsic

from deadtime.numerics.lanes.code import LANES, VECTOR, WORDS, Code, make_code

_LOG2_E, _LN2_HIGH, _LN2_LOW = (
    1.4426950408889634,
    6.93147180369123816490e-01,
    1.9082149292705877e-10,
)
_SHIFT = 1.5 * 2.0**52  # added to a number it leaves an integer in the lowest bits
_LEAST = -700.0
_FACTORIALS = [1.0]
for _k in range(1, 14):
    _FACTORIALS.append(_FACTORIALS[-1] * _k)


def _all(value: float) -> Any:
    return ir.Constant(VECTOR, [value] * LANES)


@intrinsic
def quotient(_, a, b):
    """a / b, entry by entry."""

    def work(code: Code, *parts: Any) -> list[Any]:
        return [code.builder.fdiv(*entries) for entries in zip(*parts, strict=True)]

    return make_code(a(a, b), work)


@intrinsic
def square_root(_, a):
    """The root, entry by entry; not a number below 0."""

    def work(code: Code, given: Any) -> list[Any]:
        kind = ir.FunctionType(VECTOR, [VECTOR])
        name = f"llvm.sqrt.v{LANES}f64"
        function = code.builder.module.declare_intrinsic(name, fnty=kind)
        return [code.builder.call(function, [vector]) for vector in given]

    return make_code(a(a), work)


@intrinsic
def exponential(_, a):
    """e^a of an a up to 700, 0 below −700: e^r of what is left of multiples of ln 2, |r| < 0.35."""

    def one(code: Code, given: Any) -> Any:
        build = code.builder
        y = code.larger(given, _all(_LEAST))
        shifted = code.fma(y, _all(_LOG2_E), _all(_SHIFT))
        k = build.fsub(shifted, _all(_SHIFT))
        r = code.fma(k, _all(-_LN2_LOW), code.fma(k, _all(-_LN2_HIGH), y))
        power = _all(1.0 / _FACTORIALS[-1])
        for factorial in reversed(_FACTORIALS[:-1]):
            power = code.fma(power, r, _all(1.0 / factorial))
        exponent = build.shl(build.bitcast(shifted, WORDS), code.words(52))
        result = build.bitcast(build.add(build.bitcast(power, WORDS), exponent), VECTOR)
        return build.select(build.fcmp_ordered("<", given, _all(_LEAST)), _all(0.0), result)

    def work(code: Code, given: Any) -> list[Any]:
        return [one(code, vector) for vector in given]

    return make_code(a(a), work)
