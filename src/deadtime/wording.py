"""Numbers in prose."""

from __future__ import annotations

import math


def amount(value: float) -> str:
    """A positive number for prose: three digits, a power of ten when it is far from 1.

    Examples
    --------
    >>> amount(12.345), amount(1.234e13), amount(5e-7)
    ('12.3', '1.2 × 10¹³', '5.0 × 10⁻⁷')
    """
    if value == 0.0:
        return "0"
    if 1e-3 <= value < 1e5:
        return f"{value:#.3g}".rstrip(".") if value < 999.5 else f"{value:,.0f}"
    if not math.isfinite(value):
        return "∞"
    power = math.floor(math.log10(value))
    digits = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{value / 10.0**power:.1f} × 10{digits}"


def signed(value: float) -> str:
    """A rate with its sign and two decimals.

    Examples
    --------
    >>> signed(-0.5)
    '−0.50'
    """
    return f"{value:+.2f}".replace("-", "−")


def compact(value: float) -> str:
    """A positive number for tables, at most seven characters.

    Examples
    --------
    >>> compact(12.345), compact(98765.0), compact(1.234e13), compact(5e-7)
    ('12.3', '98,765', '1.2e13', '5.0e-7')
    """
    if value == 0.0 or 1e-3 <= value < 1e5 or not math.isfinite(value):
        return amount(value)
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def subscript(number: int) -> str:
    """Digits below the line.

    Examples
    --------
    >>> subscript(12)
    '₁₂'
    """
    return str(number).translate(str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉"))


def file_name(law: str) -> str:
    """A law's name in names of files.

    Examples
    --------
    >>> file_name("mean, dwell-aware")
    'mean-dwell-aware'
    """
    return "-".join("".join(c if c.isalnum() else " " for c in law.lower()).split())
