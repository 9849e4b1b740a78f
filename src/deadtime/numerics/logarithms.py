"""Numbers kept as natural logarithms: e^{M D} with M D in the thousands does not overflow.

The logarithm of 0 is −inf.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np


def log(value: float) -> float:
    """log of a number ≥ 0."""
    return math.log(value) if value > 0.0 else -math.inf


def exp(value: float) -> float:
    """e^value, inf where it overflows."""
    return math.exp(value) if value < 709.78 else math.inf


def log_sum(values: Iterable[float]) -> float:
    """log Σ e^{v}."""
    return float(np.logaddexp.reduce(list(values)))


def log_one_plus(value: float) -> float:
    """log(1 + e^value)."""
    return float(np.logaddexp(0.0, value))


def log_integral(rate: float, length: float) -> float:
    """log ∫₀^length e^{rate τ} dτ."""
    z = rate * length
    if z == 0.0:
        return math.log(length)
    # (e^z − 1)/z = e^z (1 − e^{−z})/z, taken on the side that does not overflow.
    share = max(z, 0.0) + math.log(-math.expm1(-abs(z)) / abs(z))
    return math.log(length) + share


def log_inverse(log_function: Callable[[float], float], log_value: float) -> float:
    """The largest x with log_function(x) ≤ log_value, for an increasing log_function(x) − x.

    That is λ⁻¹ for a λ with λ(ε)/ε increasing, in logarithms: x = log ε. The inequality is checked
    for the returned x, in floats.
    """
    from scipy.optimize import brentq

    def excess(x: float) -> float:
        return min(log_function(x) - log_value, 1e300)  # brentq needs finite values

    # log λ(ε) − log ε is least as ε → 0, which gives a right end; a left end is searched.
    right = log_value - (log_function(-700.0) + 700.0)
    step = 1.0
    left = right - step
    while excess(left) > 0.0:
        step *= 2.0
        left = right - step
    if excess(right) <= 0.0:
        return right
    root: Any = brentq(excess, left, right, xtol=1e-14, maxiter=500)
    x = float(root)
    nudge = 1e-15 * max(1.0, abs(x))
    while excess(x) > 0.0:
        x -= nudge
        nudge *= 2.0
    return x
