"""Numbers and arrays as C writes them."""

from __future__ import annotations

from decimal import Decimal

import numpy as np

from deadtime.controller.export.forms import DTYPE, Precision

_LINE = 6  # numbers a line


def literal(value: float, precision: Precision) -> str:
    """The shortest decimal that reads back as the same number; an `f` on a float."""
    if precision == "float":
        text = np.format_float_scientific(np.float32(value), unique=True, trim="-")
        return _with_point(text) + "f"
    return _with_point(repr(float(value)))


def exact(value: float, precision: Precision) -> str:
    """All decimals of a number: the same real in C, in C++ and in contracts, which do not round.

    Examples
    --------
    >>> exact(2.0**70, "double"), exact(2.0**-10, "float")
    ('1180591620717411303424.0', '0.0009765625f')
    """
    return _with_point(str(Decimal(value))) + ("f" if precision == "float" else "")


def _with_point(text: str) -> str:
    return text if set(text) & set(".eE") else text + ".0"


def initializer(array: np.ndarray, precision: Precision, indent: int = 0) -> str:
    """An array as nested braces."""
    pad = " " * 4 * indent
    if array.ndim == 1:
        numbers = [literal(value, precision) for value in array.astype(DTYPE[precision])]
        lines = [
            ", ".join(numbers[start : start + _LINE]) for start in range(0, len(numbers), _LINE)
        ]
        return pad + "{" + f",\n{pad} ".join(lines) + "}"
    inner = ",\n".join(initializer(part, precision, indent + 1) for part in array)
    return f"{pad}{{\n{inner}\n{pad}}}"


def brackets(array: np.ndarray) -> str:
    """The shape as C declares it."""
    return "".join(f"[{size}]" for size in array.shape)
