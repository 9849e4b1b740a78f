"""Numbers as texts, and names that users give."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from decimal import ROUND_CEILING, ROUND_DOWN, ROUND_FLOOR, Decimal

# Malformed in XML, refused by compilers, or able to show text in another order than it has: control
# characters, marks of direction, surrogates and noncharacters.
_UNPRINTABLE = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)


def with_names(text: str, modes: Sequence[str]) -> str:
    """A sentence with the names of modes in place of "mode" and a number.

    Examples
    --------
    >>> with_names("held in mode 1 it grows", ["low flow", "high flow"])
    'held in high flow it grows'
    >>> with_names("0.5 s in mode 0, from mode 1 to 0 or 2", ["slow", "mode 1", "fast"])
    '0.5 s in slow, from mode 1 to slow or fast'
    """

    def named(match: re.Match[str]) -> str:
        numbers = re.findall(r"\d+", match[0])
        if any(int(number) >= len(modes) for number in numbers):
            return match[0]
        text = re.sub(r"\d+", lambda number: modes[int(number[0])], match[0])
        return text.removeprefix("modes ").removeprefix("mode ")

    return re.sub(r"\bmodes? \d+(?:(?: to| or| and) \d+(?![\d.]))*(?![\d.]\d)", named, text)


def one_line(text: str) -> str:
    """A user's text on one line, with unprintable characters as U+FFFD.

    Examples
    --------
    >>> one_line("my\\nplant\\x00")
    'my plant\ufffd'
    """
    return _UNPRINTABLE.sub("\ufffd", " ".join(text.split()))


def amount(value: float) -> str:
    """A positive number in a sentence: three digits, with a power of ten if it is far from 1.

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


def inwards(value: float, nominal: float) -> str:
    """An end of an interval around a nominal value, rounded towards that value.

    To three digits, or to three of its distance from the nominal value if that is smaller.

    Examples
    --------
    >>> inwards(0.10017, 5.0), inwards(1.013519, 1.0), inwards(7.019e-9, 2e-9)
    ('0.101', '1.0135', '7.01e-9')
    """
    exact, centre = Decimal(float(value)), Decimal(float(nominal))
    if not exact.is_finite() or exact in (0, centre):
        return f"{value:g}"
    places = min(exact.adjusted(), abs(exact - centre).adjusted()) - 2
    # 0.1 shall be printed as 0.1, so the shortest decimal of the double is what is rounded.
    short = Decimal(repr(float(value)))
    rounding = ROUND_CEILING if exact < centre else ROUND_FLOOR
    rounded = short.quantize(Decimal(1).scaleb(min(places, 0)), rounding)
    if abs(rounded) < 1e-4:
        mantissa, exponent = f"{rounded:e}".split("e")
        return f"{mantissa}e{int(exponent)}"
    return f"{rounded:f}"


def rounded(value: float, digits: int = 3, *, up: bool = False) -> str:
    """A number rounded down or up, so that a text claims no more than is proved.

    Examples
    --------
    >>> rounded(2.03518), rounded(0.3), rounded(0.13661, up=True), rounded(1.2999e-7, 2)
    ('2.03', '0.3', '0.137', '1.2e-07')
    """
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}".replace("inf", "∞")
    short = Decimal(repr(float(value)))
    unit = Decimal(1).scaleb(short.adjusted() - digits + 1)
    return f"{float(short.quantize(unit, ROUND_CEILING if up else ROUND_FLOOR)):.{digits}g}"


def error_percent(value: float, nominal: float) -> str:
    """The distance of a value from the nominal one in percent, rounded towards 0.

    Examples
    --------
    >>> error_percent(1.013519, 1.0), error_percent(0.98641, 1.0), error_percent(3.14159, 1.0)
    ('+1.35 %', '−1.35 %', '+214 %')
    """
    error = 100 * (Decimal(repr(float(value))) / Decimal(repr(float(nominal))) - 1)
    if error == 0:
        return "+0 %"
    rounded = error.quantize(Decimal(1).scaleb(error.adjusted() - 2), ROUND_DOWN)
    plain = Decimal("1e-4") <= abs(rounded) < Decimal("1e5")
    text = f"{rounded:+f}" if plain else f"{float(rounded):+.3g}"
    return f"{text} %".replace("-", "−")


def sentence_of(text: str) -> str:
    """A clause as a sentence.

    Examples
    --------
    >>> sentence_of("the loop is lost")
    'The loop is lost.'
    """
    return f"{text[0].upper()}{text[1:]}."


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


def as_rate(value: float) -> str:
    """A rate with its sign, to three digits.

    Examples
    --------
    >>> as_rate(-0.5), as_rate(-0.00903), as_rate(12.345), as_rate(0.0)
    ('−0.500', '−0.00903', '+12.3', '0')
    """
    sign = "−" if value < 0.0 else "+" if value > 0.0 else ""
    return f"{sign}{compact(abs(value))}"


def number_of(number: int, noun: str) -> str:
    """A number with its noun, in the plural unless the number is 1.

    Examples
    --------
    >>> number_of(1, "input"), number_of(2, "input")
    ('1 input', '2 inputs')
    """
    return f"{number} {noun}{'s' * (number != 1)}"


def subscript(number: int) -> str:
    """A number in subscript digits.

    Examples
    --------
    >>> subscript(12)
    '₁₂'
    """
    return str(number).translate(str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉"))


def numbered(letter: str, count: int) -> tuple[str, ...]:
    """The names of so many signals: the letter with subscripts from 1.

    Examples
    --------
    >>> numbered("x", 2)
    ('x₁', 'x₂')
    """
    return tuple(f"{letter}{subscript(i + 1)}" for i in range(count))


def input_names(count: int) -> tuple[str, ...]:
    """The default names of inputs.

    Examples
    --------
    >>> input_names(1), input_names(2)
    (('u',), ('u₁', 'u₂'))
    """
    return ("u",) if count == 1 else tuple(f"u{subscript(i + 1)}" for i in range(count))


def file_name(name: str) -> str:
    """The name of a law or a problem as a part of a file name.

    Examples
    --------
    >>> file_name("mean, dwell-aware")
    'mean-dwell-aware'
    """
    return "-".join("".join(c if c.isalnum() else " " for c in name.lower()).split())


def file_names(names: Iterable[str]) -> dict[str, str]:
    """Names of laws as parts of file names, with a number if an earlier law has the same.

    Examples
    --------
    >>> file_names(["+ only", "- only", "mean"])
    {'+ only': 'only', '- only': 'only-2', 'mean': 'mean'}
    """
    chosen: dict[str, str] = {}
    # No name depends on later ones, so that a further law renames no file.
    for name in dict.fromkeys(names):
        short = free = file_name(name) or "law"
        number = 1
        while free in chosen.values():
            number += 1
            free = f"{short}-{number}"
        chosen[name] = free
    return chosen
