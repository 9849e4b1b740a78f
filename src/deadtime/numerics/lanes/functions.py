"""Exponentials and logarithms of vectors."""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir

from deadtime.numerics.lanes.choices import exponent_of, mantissa_of
from deadtime.numerics.lanes.code import LANES, VECTOR, WORDS, Code

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


def exponential_of(code: Code, a: Any) -> Any:
    """e^a of an a up to 700, 0 below −700: e^r of what is left of multiples of ln 2, |r| < 0.35."""
    build = code.builder
    y = code.larger(_all(_LEAST), a)  # what is no number stays none
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
    """log a of a vector of positive normal numbers, or ∞: e ln 2 + 2 artanh s, s = (m − 1)/(m + 1).

    m is the mantissa, halved where it is above √2, so that |s| < 0.172: artanh to s²³.
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
